"""What a person reads: tables, pages, figures and exports, made from result files."""
