"""A page: one HTML file that opens offline in any browser, prints on A4, and asks the network for nothing."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, BinaryIO

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from bench.errors import RecordingExistsError
from bench.report.wording import say_count, say_mm, say_number, say_percent, say_utc, say_versions
from bench.report.writing import explain_write

__all__ = ["render_page", "write_page"]

CONTROLS = dict.fromkeys([*range(9), *range(11, 32), 127, *range(0x202A, 0x202F), *range(0x2066, 0x206A)], "\ufffd")
"""Characters without a shape of their own, but for tab and new line: ASCII controls, and those that turn direction."""


def render_page(template: str, context: Mapping[str, Any]) -> str:
    """Return the text of a page from its template; the same context gives the same text."""
    environment = Environment(
        loader=PackageLoader("bench.report"),
        autoescape=True,  # names come from configurations and devices: none of them is trusted
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        finalize=_without_controls,
    )
    environment.filters.update(mm=say_mm, number=say_number, count=say_count, percent=say_percent, utc=say_utc)
    environment.filters["versions"] = say_versions
    return environment.get_template(template).render(context)


def write_page(path: Path, text: str) -> Path:
    """Write a page under a name that is free; its folder is made when it does not exist.

    Raises
    ------
    RecordingExistsError
        There is a file of that name.
    RecordingError, DiskFullError
        The folder cannot be written.
    """
    page = text.encode("utf-8", errors="backslashreplace")
    with explain_write(f"The report cannot be written to {path}"):
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            with path.open("xb") as file:
                _write_or_remove(file, page, path)
        except FileExistsError as error:
            raise RecordingExistsError(
                f"{path} exists already and is not overwritten.", hint="Choose another --output, or move it away."
            ) from error
    return path


def _write_or_remove(file: BinaryIO, page: bytes, path: Path) -> None:
    """Leave no half page behind that a browser would show as a whole one."""
    try:
        file.write(page)
        file.flush()
    except OSError:
        path.unlink(missing_ok=True)
        raise


def _without_controls(value: object) -> object:
    """Make control characters visible: a name must not turn the direction of the text around it."""
    return value.translate(CONTROLS) if isinstance(value, str) and not isinstance(value, Markup) else value
