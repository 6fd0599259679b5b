"""One experiment from its case to its result: setup, identification, design, check, runs, metrics."""
