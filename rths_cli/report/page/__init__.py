"""The HTML page: results as one self-contained file, `rths report --format html`."""

from rths_cli.report.page.document import page, write_page

__all__ = ["page", "write_page"]
