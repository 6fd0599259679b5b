"""Numerics over numpy and scipy, and compiled code: linear systems, filters, memos, the clock."""
