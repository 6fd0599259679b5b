"""Many runs of one case: grids of varied values and seeds, kept as one table of metrics."""
