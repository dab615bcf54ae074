"""The optics judged by the first cycle of a recording whose truth is known."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from run_examples import ARC_LENGTH_M, CYCLE_S, START_S, TRACKER_HZ, RunSpec, cycle_at, radius_at, write_run

from bench.cli.check import check
from bench.errors import AnalysisError, PreflightError
from bench.model import CheckItem, RobotState
from bench.recording import open_run
from bench.report.optics_text import OpticsFindings, judge_optics


def judge(tmp_path: Path, spec: RunSpec | None = None, *changes: tuple[str, str]) -> OpticsFindings:
    """Judge a run, with its configuration changed as given."""
    path = tmp_path / "run.mcap"
    write_run(path, spec or RunSpec(n_cycles=2))
    run = open_run(path)
    config = run.config
    for table, change in changes:
        key, value = change.split("=")
        section = getattr(config, table).model_copy(update={key: eval(value)})
        config = config.model_copy(update={table: section})
    return judge_optics(run, config)


def by_name(findings: OpticsFindings) -> dict[str, CheckItem]:
    return {item.name: item for item in findings.items}


def marker_at(i: int, marker: int) -> np.ndarray:
    """Return where a marker is in frame i of the recording."""
    _, running, phase = cycle_at(i / TRACKER_HZ)
    radius = float(radius_at(phase if running else 0.0))
    angle = ARC_LENGTH_M[marker] / radius
    return np.array([radius * np.sin(angle), radius * (1 - np.cos(angle)), 0.0])


def without(hidden: Callable[[int, np.ndarray], np.ndarray]) -> Callable[[int, dict[str, Any]], dict[str, Any]]:
    """Return a hook that leaves out the points for which `hidden(frame, points)` holds."""

    def change(i: int, values: dict[str, Any]) -> dict[str, Any]:
        kept = ~hidden(i, values["points_m"])
        return values | {key: values[key][kept] for key in ("points_m", "ids", "flags", "residual_m")}

    return change


def at_phase(i: int, low: float, high: float) -> bool:
    _, running, phase = cycle_at(i / TRACKER_HZ)
    return running and low <= phase <= high


def test_a_clean_cycle_passes_but_for_its_speed(tmp_path: Path) -> None:
    findings = judge(tmp_path)
    # at 3.1 m/s this cable is faster than 100 frames/s are good for
    assert [(item.name, item.verdict) for item in findings.items] == [
        ("frame rate", "warn"),
        ("markers seen", "ok"),
        ("common view", "ok"),
        ("marker places", "ok"),
    ]
    assert not [line for line in findings.lines if line.startswith(("missing", "marker_arc_length_m"))]


def test_the_speed_of_the_fastest_marker_is_the_truths(tmp_path: Path) -> None:
    positions = np.array([marker_at(i, 5) for i in range(200)])
    true_m_s = np.linalg.norm(np.diff(positions, axis=0), axis=1).max() * TRACKER_HZ
    suggested = next(line for line in judge(tmp_path).lines if line.startswith("max_speed_m_s"))
    assert float(suggested.split("=")[1]) == pytest.approx(true_m_s, rel=0.05)


def test_a_slow_cycles_speed_is_scaled_to_full_speed(tmp_path: Path) -> None:
    def slow(state: RobotState) -> RobotState:
        return replace(state, speed_fraction=0.25)

    full = next(line for line in judge(tmp_path).lines if line.startswith("max_speed_m_s"))
    (tmp_path / "run.mcap").unlink()
    findings = judge(tmp_path, RunSpec(n_cycles=2, change_state=slow))
    scaled = next(line for line in findings.lines if line.startswith("max_speed_m_s"))
    assert float(scaled.split("=")[1]) == pytest.approx(4 * float(full.split("=")[1]), abs=0.03)
    item = by_name(findings)["frame rate"]
    assert item.verdict == "warn"
    assert "measured at 25% and scaled to full speed" in item.limit
    assert "between two frames" in item.sentence


def test_the_tcp_counts_where_it_is_faster_than_every_marker(tmp_path: Path) -> None:
    def moving(state: RobotState) -> RobotState:
        x = 4.5 * (state.controller_time_s - 50.0)
        return replace(state, tcp_pose=(x, 0.0, 0.0, 0.0, 0.0, 0.0))

    findings = judge(tmp_path, RunSpec(n_cycles=2, change_state=moving))
    assert "max_speed_m_s = 4.50" in findings.lines


def test_a_configured_speed_counts_where_it_is_larger_and_is_not_suggested_again(tmp_path: Path) -> None:
    findings = judge(tmp_path, None, ("cable", "max_speed_m_s=5.0"))
    item = by_name(findings)["frame rate"]
    assert (item.verdict, item.limit) == ("warn", ">= 500 Hz: 5.00 m/s, as configured, over 10 mm")
    assert not any("max_speed_m_s" in line for line in findings.lines)


def test_a_marker_hidden_for_part_of_the_path_is_named_with_its_phase_and_place(tmp_path: Path) -> None:
    def hidden(i: int, points: np.ndarray) -> np.ndarray:
        near = np.linalg.norm(points - marker_at(i, 2), axis=1) < 0.01
        return near & at_phase(i, 0.2, 0.5)

    findings = judge(tmp_path, RunSpec(n_cycles=2, change_points=without(hidden)))
    items = by_name(findings)
    assert items["markers seen"].verdict == "warn"
    assert "the marker at 0.3 m is seen in" in items["markers seen"].sentence
    assert items["common view"].verdict == "ok"
    (line,) = [line for line in findings.lines if line.startswith("missing")]
    assert line.startswith("missing: the marker at 0.3 m, phase 0.2")
    assert "hidden, amid what is seen" in line
    last = marker_at(round((START_S + 0.2 * CYCLE_S) * TRACKER_HZ) - 1, 2)
    place = line.split("last seen at (")[1].split(")")[0]
    assert [float(value) for value in place.split(", ")] == pytest.approx(last, abs=0.02)
    assert items["marker places"].verdict == "ok"


def test_markers_that_leave_the_view_are_named_with_where_they_go(tmp_path: Path) -> None:
    limit_m = 0.35  # the cable's end is 0.43 m up at rest
    findings = judge(tmp_path, RunSpec(n_cycles=2, change_points=without(lambda _, points: points[:, 1] > limit_m)))
    items = by_name(findings)
    assert items["common view"].verdict == "warn"
    assert "of 6 leave it" in items["common view"].value
    assert "gone out of view towards +y" in items["common view"].sentence


def test_a_misplaced_marker_is_measured_and_the_line_to_paste_is_the_truth(tmp_path: Path) -> None:
    wrong = [*ARC_LENGTH_M]
    wrong[1], wrong[4] = 0.189, 0.532  # 9 mm and 8 mm off: beyond the configured gates
    findings = judge(tmp_path, None, ("cable", f"marker_arc_length_m={tuple(wrong)}"))
    items = by_name(findings)
    assert items["markers seen"].verdict == "ok"
    assert items["marker places"].verdict == "warn"
    assert "2 of 6 markers" in items["marker places"].sentence
    line = next(line for line in findings.lines if line.startswith("marker_arc_length_m = "))
    assert eval(line.split("=")[1]) == pytest.approx(ARC_LENGTH_M, abs=0.001)


def test_a_cycle_in_which_a_marker_is_never_seen_fails(tmp_path: Path) -> None:
    def hidden(i: int, points: np.ndarray) -> np.ndarray:
        return np.asarray(np.linalg.norm(points - marker_at(i, 5), axis=1) < 0.01)

    findings = judge(tmp_path, RunSpec(n_cycles=2, change_points=without(hidden)))
    items = by_name(findings)
    assert (items["markers seen"].verdict, items["markers seen"].exit_code) == ("fail", 4)
    assert "0.66 m is seen in 0.0%" in items["markers seen"].sentence
    assert (items["marker places"].verdict, items["marker places"].value) == ("open", "not measured")
    assert any("never seen: nothing tells where it was" in line for line in findings.lines)


def test_a_check_that_fails_shows_the_whole_table_first(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    def hidden(i: int, points: np.ndarray) -> np.ndarray:
        return np.asarray(np.linalg.norm(points - marker_at(i, 5), axis=1) < 0.01)

    write_run(tmp_path / "run.mcap", RunSpec(n_cycles=2, change_points=without(hidden)))
    with pytest.raises(PreflightError, match="In no frame of the cycle") as caught:
        check(recording=tmp_path / "run.mcap")
    assert caught.value.exit_code == 4
    said = capsys.readouterr().out
    assert "open marker places" in said
    assert "missing: the marker at 0.66 m" in said


def test_many_short_stretches_are_cut_short(tmp_path: Path) -> None:
    def hidden(i: int, points: np.ndarray) -> np.ndarray:
        near = [np.linalg.norm(points - marker_at(i, m), axis=1) < 0.01 for m in range(1, 6)]
        return np.any(near, axis=0) & (i % 12 < 5)

    findings = judge(tmp_path, RunSpec(n_cycles=2, change_points=without(hidden)))
    assert sum(line.startswith("missing") for line in findings.lines) == 20
    assert any(line.endswith("shorter ones") for line in findings.lines)


def test_only_the_first_completed_cycle_counts(tmp_path: Path) -> None:
    def hidden(i: int, points: np.ndarray) -> np.ndarray:
        return (np.linalg.norm(points, axis=1) > 0.01) & (cycle_at(i / TRACKER_HZ)[0] >= 1)

    spec = RunSpec(n_cycles=2, change_points=without(hidden))
    assert by_name(judge(tmp_path, spec))["markers seen"].verdict == "ok"


def test_a_recording_without_a_completed_cycle_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(AnalysisError, match="no completed cycle"):
        judge(tmp_path, RunSpec(n_cycles=1, seconds=START_S + CYCLE_S / 2))


def test_a_cycle_without_frames_is_an_error(tmp_path: Path) -> None:
    def before(i: int, values: dict[str, Any]) -> dict[str, Any] | None:
        return values if cycle_at(i / TRACKER_HZ)[0] >= 1 or i < 20 else None

    with pytest.raises(AnalysisError, match="tracker frames were recorded in cycle 0"):
        judge(tmp_path, RunSpec(n_cycles=2, change_points=before))


def test_an_imported_take_without_a_robot_is_one_cycle(tmp_path: Path) -> None:
    findings = judge(tmp_path, RunSpec(robot=False))
    assert by_name(findings)["markers seen"].value.startswith("100.0% of")
