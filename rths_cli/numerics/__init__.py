"""Numerics over numpy alone, and compiled code: filters, matrix functions, root finding, the clock."""
