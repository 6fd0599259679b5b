"""The only rooms that see a Case: they turn it into a Setup, run it, and write what happened."""
