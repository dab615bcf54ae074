"""The second MCAP file, read back by an independent decoder."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from synthetic_results import make_results

from bench.analysis import interpolate_curve
from bench.errors import RecordingError, RecordingExistsError
from bench.report.derived import write_derived
from bench.report.results import Results

HIDDEN = 3, 7
"""Frame and marker."""
EMPTY = 5
"""A frame without any."""


@pytest.fixture
def results() -> Results:
    results = make_results(n_cycles=2, per_cycle=10)
    frames = results.frames
    places = results.marker_arc_length_m
    frames.position_m[:, :, 0] = places
    frames.position_m[:, :, 1] = 0.1 * np.sin(3 * places)
    frames.source[HIDDEN], frames.position_m[HIDDEN] = -1, np.nan
    frames.source[EMPTY], frames.position_m[EMPTY], frames.curvature_per_m[EMPTY] = -1, np.nan, np.nan
    return dataclasses.replace(results, frames=frames)


def decoded(path: Path) -> dict[str, list[Any]]:
    found: dict[str, list[Any]] = {}
    with path.open("rb") as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()], validate_crcs=True)
        for _, channel, message, values in reader.iter_decoded_messages():
            found.setdefault(channel.topic, []).append((message.sequence, message.log_time, values))
    return found


def test_markers_line_and_curvature_of_every_frame_are_those_of_the_results(tmp_path: Path, results: Results) -> None:
    found = decoded(write_derived(results, tmp_path))
    frames = results.frames
    seen = [row for row in range(len(frames.time_ns)) if row != EMPTY]
    for topic in ("/cable/markers", "/cable/line", "/cable/curvature"):
        assert [(number, time) for number, time, _ in found[topic]] == [(row, frames.time_ns[row]) for row in seen]
    for row, (_, _, cloud) in zip(seen, found["/cable/markers"], strict=True):
        points = np.frombuffer(bytes(cloud.data), "<f4").reshape(cloud.width, -1)
        here = frames.source[row] >= 0
        np.testing.assert_array_equal(points[:, :3], frames.position_m[row, here])
        assert points[:, 4].view("<u4").tolist() == np.flatnonzero(here).tolist()
    for row, (_, _, line) in zip(seen, found["/cable/line"], strict=True):
        curve = interpolate_curve(frames.position_m[row], results.marker_arc_length_m, results.arc_length_m)
        assert [[p.x, p.y, p.z] for p in line.points] == curve[np.isfinite(curve[:, 0])].tolist()
        assert (line.type, line.header.frame_id, len(line.colors)) == (4, "lab", len(line.points))
    for row, (_, _, curvature) in zip(seen, found["/cable/curvature"], strict=True):
        np.testing.assert_array_equal(np.float32(curvature.curvature_per_m), frames.curvature_per_m[row])
        assert curvature.min_bend_radius_mm == pytest.approx(1e3 / frames.curvature_per_m[row].max())


def test_each_cycle_has_its_start_and_its_end_with_the_verdict(tmp_path: Path, results: Results) -> None:
    events = [one for _, _, one in decoded(write_derived(results, tmp_path))["/cycle/event"]]
    cycles = results.cycles
    started = [(one.host_ns, one.cycle_index) for one in events if one.kind == 1]
    ended = [(one.host_ns, one.cycle_index, one.detail) for one in events if one.kind == 2]
    assert started == list(zip(cycles.start_ns, cycles.cycle_index, strict=True))
    assert ended == list(zip(cycles.end_ns, cycles.cycle_index, cycles.verdict, strict=True))


def test_a_file_that_exists_is_kept_and_a_folder_that_refuses_is_named(tmp_path: Path, results: Results) -> None:
    (tmp_path / "derived.mcap").write_bytes(b"mine")
    with pytest.raises(RecordingExistsError):
        write_derived(results, tmp_path)
    assert (tmp_path / "derived.mcap").read_bytes() == b"mine"
    with pytest.raises(RecordingError, match="cannot be written"):
        write_derived(results, tmp_path / "nowhere")
