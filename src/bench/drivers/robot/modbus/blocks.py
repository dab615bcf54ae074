"""Which addresses are read together: as few requests as the protocol allows."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

__all__ = ["Block", "plan_blocks"]

MOST_REGISTERS = 125
"""Of one request, or 2000 bits (Modbus application protocol 1.1b3, functions 1 to 4)."""


@dataclass(frozen=True, slots=True)
class Block:
    """Addresses of one table that are read by one request, counted from 0."""

    table: str
    address: int
    count: int

    def __str__(self) -> str:
        return f"{self.table} {self.address}..{self.address + self.count - 1}"


def plan_blocks(spans: Iterable[tuple[str, int, int]], gap: int, most: int = MOST_REGISTERS) -> list[Block]:
    """Return the blocks that cover all spans, each span whole in one block.

    Parameters
    ----------
    spans : iterable of (table, address, count)
        What must be read.
    gap : int
        Addresses that may be read along, if that saves a request.
    most : int
        Registers of one request; of bits 16 times as many.
    """
    blocks: list[Block] = []
    for table, address, count in sorted(spans):
        limit = most * 16 if table in ("coil", "discrete") else most
        last = blocks[-1] if blocks else None
        if last is not None and last.table == table and address <= last.address + last.count + gap:
            n = max(last.address + last.count, address + count) - last.address
            if n <= limit:
                blocks[-1] = Block(table, last.address, n)
                continue
        blocks.append(Block(table, address, count))
    return blocks
