"""What is computed without moving a table: SIM and SIM-DELAY, stability, predicted error, error budget, metrics."""
