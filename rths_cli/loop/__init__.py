"""All that happens while a table moves: the step, the guard, clocks, lost samples, logs."""
