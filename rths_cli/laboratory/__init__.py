"""Commands beside a run: doctor, calibration, serving a virtual table, recovery, and what a building or record is."""
