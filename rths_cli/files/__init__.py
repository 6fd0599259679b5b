"""Files this project reads and writes: results (HDF5) and accelerograms."""
