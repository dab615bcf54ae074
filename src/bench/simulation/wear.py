"""A cable that gets softer from cycle to cycle: quantities along the path at any state of its wear."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import numpy.typing as npt

from bench.simulation.cable import Cable, PlaceTable

__all__ = ["LEVELS", "Wear", "WearTable"]

Floats = npt.NDArray[np.float64]

LEVELS: tuple[float, ...] = tuple((0.5 - 0.5 * np.cos(np.pi * np.arange(5) / 4)).tolist())
"""Shares of the wear at which the shape is solved: Chebyshev's points, between which a polynomial does not swing. With
five, markers are where a solved shape has them to 0.004 mm, with four to 0.02 mm (the stiffness falling to half)."""


class WearTable:
    """A quantity along the path, interpolated between the tables of the same cable at `LEVELS` of its wear.

    Parameters
    ----------
    tables : sequence of PlaceTable
        One for each of `LEVELS`, or a single one for a cable that does not wear.
    n_cycles : int
        Cycles in which the cable wears from the first to the last of them.
    """

    def __init__(self, tables: Sequence[PlaceTable], n_cycles: int) -> None:
        self._tables = tables
        self._n_cycles = max(n_cycles, 1)
        levels = np.array(LEVELS[: len(tables)])
        self._basis = np.linalg.inv(np.vander(levels, increasing=True))

    def at(self, place: float, cycles_driven: float) -> Floats:
        """Return the quantity at one place, 0 to 1, of a cable that was driven so many cycles."""
        if len(self._tables) == 1:
            return self._tables[0].at(place)
        weights = self._weigh(np.array([cycles_driven]))[0]
        return np.asarray(sum(weight * table.at(place) for weight, table in zip(weights, self._tables, strict=True)))

    def at_many(self, places: Floats, cycles_driven: Floats) -> Floats:
        """Return the quantity (m, ...) at m places after as many numbers of cycles."""
        if len(self._tables) == 1:
            return self._tables[0].at_many(places)
        at_levels = np.stack([table.at_many(places) for table in self._tables])
        return np.asarray(np.einsum("ml,lm...->m...", self._weigh(cycles_driven), at_levels))

    def _weigh(self, cycles_driven: Floats) -> Floats:
        share = np.minimum(cycles_driven / self._n_cycles, 1.0)
        return np.asarray(np.vander(share, len(self._tables), increasing=True) @ self._basis)


class Wear:
    """One cable at all `LEVELS` of its wear, or a single one that does not wear.

    Parameters
    ----------
    cables : sequence of Cable
        The new one first.
    n_cycles : int
        Cycles from the first to the last; 0 with a single one.
    """

    def __init__(self, cables: Sequence[Cable], n_cycles: int) -> None:
        self._cables = cables
        self._n_cycles = n_cycles

    @property
    def new(self) -> Cable:
        """The cable before its first cycle."""
        return self._cables[0]

    def tabulate(self, make_table: Callable[[Cable], PlaceTable]) -> WearTable:
        """Return a quantity that each state of the cable has a table of."""
        return WearTable([make_table(cable) for cable in self._cables], self._n_cycles)
