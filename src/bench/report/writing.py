"""What the system refuses while a result is written, as an error of ours."""

from __future__ import annotations

import errno
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from bench.errors import DiskFullError, RecordingError

__all__ = ["explain_write", "in_system_words"]


def in_system_words(error: OSError) -> str:
    """Return the system's own words for an error that a library has wrapped in more of its own."""
    return os.strerror(error.errno).lower() if error.errno else str(error)


@contextmanager
def explain_write(
    cannot: str, reason: Callable[[OSError], object] = lambda error: error.strerror or error
) -> Iterator[None]:
    """Raise an `OSError` as `DiskFullError` or `RecordingError`.

    Parameters
    ----------
    cannot : str
        Beginning of the sentence: what cannot be written, and where.
    reason : callable, optional
        Its end.
    """
    try:
        yield
    except OSError as error:
        kind = DiskFullError if error.errno == errno.ENOSPC else RecordingError
        raise kind(f"{cannot}: {reason(error)}.") from error
