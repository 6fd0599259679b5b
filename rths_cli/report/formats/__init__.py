"""A report in the formats that a page, a spreadsheet, a program or a paper takes: one module each, one form in."""
