"""Files that are read and written: results, models, sweeps, raw logs, accelerograms, measured data."""
