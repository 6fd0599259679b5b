"""What `make bench` measures, part by part: each gives rows of one table."""
