"""From excitation plan to frequency responses, table model and specimen."""
