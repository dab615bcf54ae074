"""The page about faults says what the product says."""

from __future__ import annotations

import re

import pytest
from markdown_pages import ROOT

import bench
from bench.run.conditions import ConditionKind
from bench.run.robot_words import UR_WORDS

PAGE = (ROOT / "docs" / "reference" / "what-happens-when.md").read_text(encoding="utf-8")
PRODUCT = "\n".join(
    path.read_text(encoding="utf-8")
    for path in sorted(ROOT.joinpath("src", bench.__name__).rglob("*.py"))
    if "simulation" not in path.parts
)
IN_ONE_PIECE = re.sub(r'"\s*\n\s*f?"', "", PRODUCT)
"""The same with each sentence that is written over several lines in one piece."""
JOINED = IN_ONE_PIECE.replace("{panel}", UR_WORDS.panel).replace("{slider}", UR_WORDS.slider)
"""And in the words of a UR."""


QUOTED = {words for row in PAGE.splitlines() if row.startswith("|") for words in re.findall(r'"([^"]+)"', row)}


@pytest.mark.parametrize("words", sorted(QUOTED))
def test_the_words_on_the_screen_are_the_products(words: str) -> None:
    assert words in JOINED


def test_every_condition_with_a_policy_has_its_row() -> None:
    kinds = {str(kind) for kind in ConditionKind} - {"program_paused"}
    assert [kind for kind in kinds if f"`{kind}`" not in PAGE] == []
