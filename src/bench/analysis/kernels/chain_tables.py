"""How the chain search's tables of costs are laid out: for those who fill them and for the loops that read them."""

__all__ = ["BINS", "MOST_END_COST", "MOST_GAP"]

MOST_GAP = 4
"""Largest step from one seen marker to the next: three hidden between them."""
BINS = 64
"""Of a table, between which costs are interpolated."""
MOST_END_COST = 8.0
"""However far the chain is from where the calibration puts the cable's end, it costs no more than a hidden marker."""
