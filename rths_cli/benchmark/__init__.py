"""Benchmarks: every compensator put to the same test, on plants that scatter; the table of all."""
