"""The layout for Lichtblick shows what is in a recording."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from typing import Any

from markdown_pages import CONFIGS

from bench.recording.messages.schemas import load_schema
from bench.recording.messages.topics import TOPICS

LAYOUT = json.loads((CONFIGS / "lichtblick_layout.json").read_text(encoding="utf-8"))


def test_every_panel_has_its_place_once() -> None:
    assert sorted(find_panels(LAYOUT["layout"])) == sorted(LAYOUT["configById"])


def test_every_curve_is_a_field_of_a_topic() -> None:
    paths = [path["value"] for panel in LAYOUT["configById"].values() for path in panel.get("paths", [])]
    assert len(paths) > 4
    for path in paths:
        topic, name, index = re.fullmatch(r"(/[\w/]+)\.(\w+)(?:\[(\d)\])?", path).groups()  # type: ignore[union-attr]
        lengths = {field.name: field.length for field in load_schema(TOPICS[topic].schema).fields}
        assert name in lengths, path
        assert (index is None) == (lengths[name] is None), path
        assert index is None or int(index) < lengths[name], path


def test_points_and_log_are_where_the_recording_has_them() -> None:
    panels = LAYOUT["configById"]
    assert set(panels["3D!points"]["topics"]) <= TOPICS.keys()
    assert panels["RosOut!log"]["topicToRender"] in TOPICS


def find_panels(place: Any) -> Iterator[str]:
    if isinstance(place, str):
        yield place
    else:
        yield from find_panels(place["first"])
        yield from find_panels(place["second"])
