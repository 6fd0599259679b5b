"""A report in one format each: CSV, JSON, JUnit, LaTeX, Markdown."""
