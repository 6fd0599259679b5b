"""Result files in the formats of other programs: CSV, MATLAB."""
