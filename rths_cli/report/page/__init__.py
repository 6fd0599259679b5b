"""The report page: results as one self-contained HTML file."""

from rths_cli.report.page.document import page, write_page

__all__ = ["page", "write_page"]
