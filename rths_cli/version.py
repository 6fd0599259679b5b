"""The version of rths."""

__version__ = "0.2.0"
