"""The version of rths."""

__version__ = "0.1.0"
