"""What is known without moving a table: SIM and SIM-DELAY, the references of every error."""
