"""Publication figures of results: the paper's figures and further ones, for any structure, rig and number of storeys.

docs/reference/figures.md says what each one shows.
"""

from rths_cli.report.figures.figure_data import NotDrawn
from rths_cli.report.figures.write import draw, figure_names, write_figures

__all__ = ["NotDrawn", "draw", "figure_names", "write_figures"]
