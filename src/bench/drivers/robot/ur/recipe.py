"""Recipes: which values a data package holds, compiled to one `struct.Struct`."""

from __future__ import annotations

import struct
from collections.abc import Sequence

from bench.errors import ProtocolError

__all__ = ["DATA_TYPES", "Recipe", "Scalar", "Value"]

Scalar = float | int | bool
Value = Scalar | tuple[Scalar, ...]
"""One value of a recipe: a number, or a tuple of 3 or 6."""

DATA_TYPES: dict[str, tuple[str, int]] = {
    "BOOL": ("?", 1),
    "UINT8": ("B", 1),
    "UINT32": ("I", 1),
    "INT32": ("i", 1),
    "UINT64": ("Q", 1),
    "DOUBLE": ("d", 1),
    "VECTOR3D": ("d", 3),
    "VECTOR6D": ("d", 6),
    "VECTOR6INT32": ("i", 6),
    "VECTOR6UINT32": ("I", 6),
}
"""`struct` code and number of elements of each type (RTDE guide)."""


class Recipe:
    """The layout of the data packages of one recipe.

    Data travels *flat*: one tuple of numbers, vectors laid out one after the other. `key` tells where a name lies in
    it, as an index for a number and a slice for a vector.

    Parameters
    ----------
    names, types : sequence of str
        The names in the order of the recipe, and the controller's type for each.
    recipe_id : int or None
        The recipe's number, which heads each package; None where the package has none (outputs, protocol version 1).

    Attributes
    ----------
    width : int
        How many numbers `unpack` returns.

    Raises
    ------
    ProtocolError
        A type is unknown, or there are not as many types as names.
    """

    def __init__(self, names: Sequence[str], types: Sequence[str], recipe_id: int | None) -> None:
        if len(names) != len(types):
            raise ProtocolError(f"an RTDE setup of {len(names)} names was answered by {len(types)} types.")
        self.recipe_id = recipe_id
        self.names = tuple(names)
        self.types = tuple(types)
        head = "" if recipe_id is None else "B"
        self._head: tuple[int, ...] = () if recipe_id is None else (recipe_id,)
        self._keys: dict[str, int | slice] = {}
        codes, place = [], len(head)
        for name, kind in zip(names, types, strict=True):
            if kind not in DATA_TYPES:
                raise ProtocolError(f"the controller gives '{name}' the type '{kind}', which RTDE does not have.")
            code, count = DATA_TYPES[kind]
            codes.append(code * count)
            self._keys[name] = place if count == 1 else slice(place, place + count)
            place += count
        self.width = place
        self._struct = struct.Struct(">" + head + "".join(codes))

    @property
    def size(self) -> int:
        """Bytes of a package's payload."""
        return self._struct.size

    def key(self, name: str) -> int | slice:
        """Return where `name` lies in what `unpack` returns; `KeyError` if the recipe has no such name."""
        return self._keys[name]

    def pack(self, flat: Sequence[Scalar]) -> bytes:
        """Write the payload of a data package; `struct.error` if a number does not fit its type."""
        return self._struct.pack(*self._head, *flat)

    def unpack(self, payload: bytes) -> tuple[Scalar, ...]:
        """Read the payload of a data package: the recipe's number (if it has one), then all values flat.

        Raises
        ------
        ProtocolError
            The payload has another length, or belongs to another recipe.
        """
        if len(payload) != self._struct.size:
            raise ProtocolError(f"an RTDE data package of {len(payload)} bytes came where {self.size} are due.")
        if self._head and payload[0] != self.recipe_id:
            raise ProtocolError(f"an RTDE data package of recipe {payload[0]} came where {self.recipe_id} is set up.")
        return self._struct.unpack(payload)

    def encode(self, values: Sequence[Value]) -> bytes:
        """Write a payload from one value for each name."""
        flat: list[Scalar] = []
        for value in values:
            if isinstance(value, tuple):
                flat.extend(value)
            else:
                flat.append(value)
        return self.pack(flat)

    def decode(self, payload: bytes) -> dict[str, Value]:
        """Read a payload into one value for each name."""
        flat = self.unpack(payload)
        return {name: flat[key] for name, key in self._keys.items()}
