"""Many runs of one case: `rths sweep`."""
