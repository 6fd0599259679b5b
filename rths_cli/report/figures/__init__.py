"""Publication figures (PDF, PNG, SVG) of results, drawn by matplotlib: `rths report --figures`.

docs/reference/figures.md says what each one shows.
"""

from rths_cli.report.figures.figure_data import NotDrawn
from rths_cli.report.figures.write import draw, figure_names, write_figures, write_sweep_figures

__all__ = ["NotDrawn", "draw", "figure_names", "write_figures", "write_sweep_figures"]
