"""What a person reads: tables, the paper's claims and exports, from result files."""
