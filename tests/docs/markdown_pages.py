"""Finds what a page of the documentation holds: fenced blocks with their notes, headings and links."""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
CONFIGS = ROOT / "bench_configs"

_NOTE = re.compile(r"<!--\s*([a-z ]+?)\s*(?::\s*(.*?)\s*)?-->")
_LINK = re.compile(r"!?\[[^\]]*\]\(([^)\s]+)\)")


@dataclass(frozen=True)
class Block:
    """One fenced block."""

    page: Path
    line: int
    language: str
    text: str
    notes: dict[str, str] = field(default_factory=dict)
    """From the HTML comments right above the block: ``file: NAME``, ``lab only``, ``needs: LIBRARY`` and so on."""

    @property
    def place(self) -> str:
        return f"{self.page.relative_to(ROOT)}:{self.line}"


def find_pages() -> list[Path]:
    """Return every page of the documentation, the README first."""
    names = ["README.md", "CONTRIBUTING.md", "CHANGELOG.md"]
    return [ROOT / name for name in names] + sorted((ROOT / "docs").rglob("*.md"))


def find_blocks(page: Path) -> list[Block]:
    """Return the fenced blocks of a page in their order."""
    blocks: list[Block] = []
    notes: dict[str, str] = {}
    body: list[str] = []
    opened: tuple[int, str] | None = None
    for number, line in enumerate(page.read_text(encoding="utf-8").splitlines(), start=1):
        if opened is not None:
            if line.strip() == "```":
                blocks.append(Block(page, opened[0], opened[1], "\n".join(body) + "\n", notes))
                opened, notes, body = None, {}, []
            else:
                body.append(line)
        elif line.startswith("```"):
            opened = (number, line[3:].strip())
        elif note := _NOTE.fullmatch(line.strip()):
            notes = {**notes, note[1]: note[2] or ""}
        elif line.strip():
            notes = {}
    if opened is not None:
        raise ValueError(f"{page}:{opened[0]}: the block is never closed")
    return blocks


def find_links(page: Path) -> list[str]:
    """Return the targets of a page's links and pictures, outside of fenced blocks."""
    return [target for line in _prose_lines(page) for target in _LINK.findall(re.sub(r"`[^`]*`", "", line))]


def find_anchors(page: Path) -> set[str]:
    """Return the anchors that a page's headings have on the usual forges."""
    headings = [line.lstrip("#").strip() for line in _prose_lines(page) if re.match(r"#{1,6} ", line)]
    return {_anchor(heading) for heading in headings}


def find_commands(block: Block) -> list[str]:
    """Return the commands of a console block: lines that begin with ``$``, joined where they end with a backslash."""
    joined = re.sub(r"\\\n\s*", "", block.text)
    return [line[2:].strip() for line in joined.splitlines() if line.startswith("$ ")]


def _anchor(heading: str) -> str:
    plain = re.sub(r"[`*]", "", re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", heading)).lower()
    return re.sub(r"[^\w\- ]", "", plain).replace(" ", "-")


def _prose_lines(page: Path) -> list[str]:
    lines, fenced = [], False
    for line in page.read_text(encoding="utf-8").splitlines():
        if line.startswith("```"):
            fenced = not fenced
        elif not fenced:
            lines.append(line)
    return lines
