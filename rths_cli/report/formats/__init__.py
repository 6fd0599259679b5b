"""A report as data: CSV, JSON, JUnit."""
