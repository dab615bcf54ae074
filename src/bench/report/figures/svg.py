"""From a matplotlib figure to SVG text that may stand in a page beside others, the same bytes every time."""

from __future__ import annotations

import io
import re
from collections.abc import Iterator
from contextlib import contextmanager
from html import escape
from typing import Any, cast

import matplotlib as mpl
from matplotlib.figure import Figure

__all__ = ["INK", "MUTED", "PALE", "WARNING_INK", "drawing", "new_figure", "to_svg"]

INK = "#1f4e79"
"""Colour of what was measured."""
MUTED = "#6b7580"
"""Colour of axes, and of what is only there for comparison."""
PALE = "#b9cde0"
"""Colour of a band around what was measured; still seen on a grey printer."""
WARNING_INK = "#b3261e"
"""Colour of the catalogue limit and of what crosses it."""

WIDTH_IN = 8.6
"""Drawn at this width and scaled by the page: 9 pt letters become 10.5 pt on a screen and 7.3 pt on A4."""
RASTER_DPI = 180
"""Resolution of coloured areas inside an SVG: sharp in print, and a whole map stays below 200 kB."""

LINES = "stroke-linejoin: round; stroke-linecap: butt"
"""Takes the place of matplotlib's style element, which inside a page would be the style of the whole page."""

STYLE: dict[str, Any] = {
    "axes.axisbelow": True,
    "axes.edgecolor": MUTED,
    "axes.grid": True,
    "axes.labelcolor": "#222222",
    "axes.labelsize": 9,
    "axes.linewidth": 0.7,
    "axes.spines.right": False,
    "axes.spines.top": False,
    "axes.titlelocation": "left",
    "axes.titlesize": 9.5,
    "axes.titleweight": "bold",
    "axes.unicode_minus": True,
    "figure.facecolor": "none",
    "font.size": 9,
    "grid.color": "#e3e7eb",
    "grid.linewidth": 0.6,
    "legend.fontsize": 8.5,
    "legend.frameon": False,
    "svg.fonttype": "none",  # letters stay letters: they can be searched, read aloud, and take the page's font
    "svg.hashsalt": "bench",  # a fixed salt gives the same element names every time
    "xtick.color": MUTED,
    "xtick.labelcolor": "#333333",
    "xtick.labelsize": 8.5,
    "ytick.color": MUTED,
    "ytick.labelcolor": "#333333",
    "ytick.labelsize": 8.5,
}


@contextmanager
def drawing() -> Iterator[None]:
    """Draw in the report's style, whatever the user's matplotlibrc says, and leave the settings as they were."""
    with mpl.rc_context():
        mpl.rcdefaults()
        mpl.rcParams.update(cast(Any, STYLE))
        yield


def new_figure(height_in: float) -> Figure:
    """Return an empty figure as wide as the page; call inside `drawing`."""
    return Figure(figsize=(WIDTH_IN, height_in), layout="constrained")


def to_svg(figure: Figure, name: str, title: str, description: str) -> str:
    """Return the figure as an ``<svg>`` element; call inside `drawing`.

    Parameters
    ----------
    figure : Figure
    name : str
        Put before every id, so that two figures can stand in one page.
    title, description : str
        What a screen reader says.

    Returns
    -------
    str
        Well-formed XML without prolog; the same figure gives the same text.
    """
    buffer = io.StringIO()
    unsaid = dict.fromkeys(("Date", "Creator", "Format", "Type"))
    figure.savefig(buffer, format="svg", dpi=RASTER_DPI, metadata=unsaid)
    body = buffer.getvalue().split("<svg", 1)[1]
    attributes, content = body.split(">", 1)
    described = f'role="img" aria-labelledby="{name}-title {name}-description" style="{LINES}"'
    head = f"<svg {described}{_scalable(attributes)}>"
    words = (
        f'<title id="{name}-title">{escape(title)}</title><desc id="{name}-description">{escape(description)}</desc>'
    )
    return head + words + _with_own_ids(content, name).strip()


def _scalable(attributes: str) -> str:
    """Drop the fixed size: the page's style decides, the view box keeps the proportions."""
    return re.sub(r'\s(width|height)="[^"]*"', "", attributes)


def _with_own_ids(content: str, name: str) -> str:
    content = re.sub(r"<(metadata|style)\b.*?</\1>\s*", "", content, flags=re.DOTALL)
    content = re.sub(r'(\sid=")', rf"\g<1>{name}-", content)
    return re.sub(r'(url\(#|href="#)', rf"\g<1>{name}-", content)
