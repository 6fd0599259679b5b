"""Case files: YAML as a researcher writes it, checked completely and turned into frozen data."""
