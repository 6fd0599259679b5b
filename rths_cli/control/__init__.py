"""Design of the discrete blocks that the step runs, from what was identified and declared."""
