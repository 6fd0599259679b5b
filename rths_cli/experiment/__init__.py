"""One experiment from its case to its result: setup, model, design, check, runs, metrics; what each command does."""
