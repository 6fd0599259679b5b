"""All that happens while a table moves: the compiled step, the guard, and the drive that joins them to a rig."""
