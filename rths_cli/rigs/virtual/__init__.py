"""The virtual table: hidden physics behind the same interface as a real rig. Only this room reads `physics`."""
