"""Sorted markers in the formats that other programs read.

`bench.report.export.formats` writes them; it is not loaded here, so that the command line can name the formats
without the libraries that write them.
"""

from bench.report.export.kinds import ExportFormat

__all__ = ["ExportFormat"]
