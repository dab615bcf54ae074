"""What sorted markers can be exported as."""

from __future__ import annotations

from enum import StrEnum

__all__ = ["ExportFormat"]


class ExportFormat(StrEnum):
    """A file format, named by its files' suffix."""

    CSV = "csv"
    C3D = "c3d"
    TRC = "trc"
    PARQUET = "parquet"
