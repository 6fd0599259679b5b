"""The virtual table with the imperfections of a real one: general equations of motion and an adaptive integration."""
