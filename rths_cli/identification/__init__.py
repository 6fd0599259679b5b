"""From excitation plan and records to frequency responses, table model, specimen and verdict."""
