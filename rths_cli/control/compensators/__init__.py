"""The compensators of rths: one module each, with the names of `control.compensator`."""
