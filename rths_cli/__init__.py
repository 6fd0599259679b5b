"""Substructure real-time hybrid simulation (RTHS) with a uni-axial shake table."""

__version__ = "0.1.0"
