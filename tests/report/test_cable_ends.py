"""The cable's ends in the report: by a rigid body, by the robot's pose, or not at all and said so."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from run_examples import ARC_LENGTH_M, BODY_ANCHOR, ROBOT_HZ, TRACKER_HZ, RunSpec, cycle_at, radius_at, write_run

from bench.analysis import CableEnd
from bench.model import DeviceInfo, RigidBody, RobotState
from bench.recording import open_run
from bench.report.ends import CableEnds, warn_of_end_bend
from bench.report.pipeline import analyse_run
from bench.report.results import Results

QUARTER_TURN = (0.0, 0.0, float(np.sqrt(0.5)), float(np.sqrt(0.5)))
"""About z: x becomes y."""
LENGTH_M = 0.8
SPACING_M = ARC_LENGTH_M[1] - ARC_LENGTH_M[0]
CALIBRATED = """
[calibration.measured]
run_file = "cal.mcap"
run_id = "a"
created_utc = "2026-11-22T06:00:00Z"
bench_version = "0"
[calibration.measured.time]
offset_ms = 0.0
offset_sd_ms = 0.01
[calibration.measured.space]
method = "marker"
lab_from_base_rotation_rad = [0.0, 0.0, 0.0]
lab_from_base_shift_m = [0.0, 0.0, 0.0]
lab_from_base_covariance = [
    [1e-8, 0.0, 0.0, 0.0, 0.0, 0.0], [0.0, 1e-8, 0.0, 0.0, 0.0, 0.0], [0.0, 0.0, 1e-8, 0.0, 0.0, 0.0],
    [0.0, 0.0, 0.0, 1e-8, 0.0, 0.0], [0.0, 0.0, 0.0, 0.0, 1e-8, 0.0], [0.0, 0.0, 0.0, 0.0, 0.0, 1e-8],
]
tcp_from_body_shift_m = [0.0, 0.0, 0.0]
tcp_from_body_sd_mm = [0.1, 0.1, 0.1]
residual_rms_mm = 0.3
residual_max_mm = 0.9
n_frames = 1000
n_outliers = 0
"""


def on_cable(seconds: float, arc_length_m: float) -> np.ndarray:
    """Return a place on the cable of `run_examples`, at a time after the start."""
    _, running, phase = cycle_at(seconds)
    radius = float(radius_at(phase if running else 0.0))
    angle = arc_length_m / radius
    return np.array([radius * np.sin(angle), radius * (1 - np.cos(angle)), 0.0])


def hold_end(away_m: float = 0.0) -> Any:
    """Return a hook that puts the rigid body `tool` on the cable's end."""

    def change(index: int, values: dict[str, Any]) -> dict[str, Any]:
        x, y, z = (on_cable(index / TRACKER_HZ, LENGTH_M) + np.array([0.0, 0.0, away_m])).tolist()
        return {**values, "bodies": (*values["bodies"], RigidBody(2, (x, y, z), QUARTER_TURN))}

    return change


def analyse(folder: Path, spec: RunSpec) -> tuple[Results, np.ndarray]:
    truth = write_run(folder / "run.mcap", spec)
    return analyse_run(open_run(folder / "run.mcap")), truth


HELD = RunSpec(
    extra_toml='[cable.end]\nkind = "rigid_body"\nname = "tool"\n'
    "clamp_direction = [2.0, 0.0, 0.0]\nclamp_sd_deg = 1.0\n",
    devices=[DeviceInfo("tracker", "natnet", "", bodies={1: "pole", 2: "tool"})],
    change_points=hold_end(),
)


def test_a_rigid_body_at_the_end_tells_its_place_and_direction(tmp_path: Path) -> None:
    results, _ = analyse(tmp_path, HELD)
    assert results.ends is not None
    expected = [on_cable((number - 1000) / TRACKER_HZ, LENGTH_M) for number in results.frames.frame_number]
    assert results.ends.end_position_m == pytest.approx(np.array(expected), abs=1e-9)
    assert results.ends.end_tangent == pytest.approx(np.tile([0.0, 1.0, 0.0], (len(expected), 1)), abs=1e-9)
    assert results.ends.end_tangent_sigma_rad == pytest.approx(np.deg2rad(1.0))
    assert np.isnan(results.ends.anchor_tangent).all()
    assert "last marker" in results.run_facts["Cable's end"]
    assert "140.0 mm of cable" in results.run_facts["Cable's end"]
    assert not [text for text in results.warnings if "cable's end" in text]


def test_an_end_that_is_too_vague_for_the_curve_is_said_not_to_be_used(tmp_path: Path) -> None:
    def describe(spec: RunSpec, name: str) -> list[str]:
        (tmp_path / name).mkdir()
        notes = analyse(tmp_path / name, replace(spec, n_cycles=1))[0].method_notes["curvature"]
        return [text for text in notes if "[cable.end]" in text]

    assert "10 mm" in describe(HELD, "vague")[0]
    assert describe(replace(HELD, extra_toml=HELD.extra_toml + "clamp_m = [0.0, 0.0, 0.0]\n"), "known") == []


def test_an_end_that_no_cable_reaches_is_a_warning(tmp_path: Path) -> None:
    results, truth = analyse(tmp_path, replace(HELD, change_points=hold_end(0.3)))
    assert any("mm from the cable's end" in text and "clamp_m" in text for text in results.warnings)
    assert np.array_equal(results.frames.source, truth)


def test_a_hidden_marker_costs_one_marker_where_the_end_is_known(tmp_path: Path) -> None:
    def hide(index: int, values: dict[str, Any]) -> dict[str, Any]:
        changed = hold_end()(index, values)
        shown = np.linalg.norm(values["points_m"] - on_cable(index / TRACKER_HZ, ARC_LENGTH_M[2]), axis=1) > 0.01
        kept = {name: values[name][shown] for name in ("points_m", "ids", "flags", "residual_m")}
        return {**changed, **kept}

    results, _ = analyse(tmp_path, replace(HELD, analysis='sorting = "chain"', change_points=hide))
    found = (results.frames.source >= 0).mean(axis=0)
    assert found.tolist() == [1, 1, 0, 1, 1, 1]


def test_the_anchors_clamp_points_as_configured(tmp_path: Path) -> None:
    anchor = 'kind = "static_marker"\nclamp_direction = [0.0, 3.0, 4.0]'
    results, _ = analyse(tmp_path, RunSpec(anchor=anchor))
    assert results.ends is not None
    assert results.ends.anchor_tangent == pytest.approx(np.tile([0.0, 0.6, 0.8], (len(results.frames.time_ns), 1)))
    assert results.ends.anchor_tangent_sigma_rad == pytest.approx(np.deg2rad(2.0))
    assert np.isnan(results.ends.end_position_m).all()


def test_the_poles_body_turns_its_clamp(tmp_path: Path) -> None:
    def turn(_: int, values: dict[str, Any]) -> dict[str, Any]:
        return {**values, "bodies": (replace(values["bodies"][0], quaternion_xyzw=QUARTER_TURN),)}

    spec = RunSpec(anchor=f"{BODY_ANCHOR}\nclamp_direction = [1.0, 0.0, 0.0]", change_points=turn)
    results, _ = analyse(tmp_path, replace(spec, devices=[DeviceInfo("tracker", "natnet", "", bodies={1: "pole"})]))
    assert results.ends is not None
    assert np.allclose(results.ends.anchor_tangent, [0.0, 1.0, 0.0])


def test_an_end_at_the_tcp_without_a_calibration_is_said_not_to_be_used(tmp_path: Path) -> None:
    results, _ = analyse(tmp_path, RunSpec(extra_toml='[cable.end]\nkind = "tcp"\n'))
    assert results.ends is None
    assert any("kind = 'tcp' is not used" in text for text in results.warnings)


def test_a_robot_that_tells_no_pose_leaves_the_calibrated_end_unused(tmp_path: Path) -> None:
    results, _ = analyse(tmp_path, RunSpec(extra_toml='[cable.end]\nkind = "tcp"\n' + CALIBRATED))
    assert results.ends is None
    assert any("needs a robot that tells its TCP pose" in text for text in results.warnings)


@pytest.mark.parametrize(("set_m", "warned"), [(0.12, False), (0.15, True)])
def test_another_tcp_than_in_the_calibration_is_a_warning(tmp_path: Path, set_m: float, warned: bool) -> None:
    def tell(state: RobotState) -> RobotState:
        return replace(state, tcp_pose=(0.5, state.sequence * 1e-4, 0, 0, 0, 0), tcp_offset=(0, 0, set_m, 0, 0, 0))

    calibrated = f"{CALIBRATED}tcp_offset = [0.0, 0.0, 0.12, 0.0, 0.0, 0.0]\n"
    results, _ = analyse(tmp_path, RunSpec(extra_toml=calibrated, change_state=tell))
    told = [text for text in results.warnings if "The TCP was set to (0.0, 0.0, 150.0) mm" in text]
    assert len(told) == warned


def test_the_marker_on_the_flange_is_not_taken_for_the_cables(tmp_path: Path) -> None:
    def beside_cable(seconds: float) -> np.ndarray:
        return on_cable(seconds, ARC_LENGTH_M[2]) + np.array([0.0, 0.0, SPACING_M])

    def move(state: RobotState) -> RobotState:
        x, y, z = beside_cable(state.sequence / ROBOT_HZ).tolist()
        return replace(state, tcp_pose=(x, y, z, 0.0, 0.0, 0.0))

    def show(index: int, values: dict[str, Any]) -> dict[str, Any]:
        more = {"points_m": [beside_cable(index / TRACKER_HZ)], "ids": [7], "flags": [0x12], "residual_m": [np.nan]}
        merged = {name: np.concatenate([values[name], np.array(one)]) for name, one in more.items()}
        return {**values, **{name: merged[name].astype(values[name].dtype) for name in more}}

    spec = RunSpec(change_state=move, change_points=show)
    fooled, truth = analyse(tmp_path, replace(spec, analysis='sorting = "paper"'))
    assert (fooled.frames.source != truth).any(axis=1).mean() > 0.5
    (tmp_path / "run.mcap").unlink()
    results, truth = analyse(tmp_path, replace(spec, extra_toml=CALIBRATED))
    known = slice(2, len(truth) - 5)
    assert np.array_equal(results.frames.source[known], truth[known])
    assert results.run_facts["Time offset"].startswith("+0.000 ms (sd 0.010 ms)")


def warn_of(bend_m: float, ends: CableEnds, method: str = "menger_gp", more: float = 1.0) -> list[str]:
    """Return what is said of a cable of 5 markers 0.1 m apart, the first at 0, that bends more at a place."""
    places = np.linspace(0.0, 0.4, 41)
    traced: Any = SimpleNamespace(
        curve=SimpleNamespace(method=method), arc_length_m=places, marker_arc_length_m=np.linspace(0.0, 0.4, 5)
    )
    bends = 2.0 + more * (np.abs(places - bend_m) < 0.005) * np.linspace(0, 1, 10)[:, None]
    bends[3] = np.nan
    return warn_of_end_bend(ends, traced, bends)


def test_a_largest_bend_beside_a_clamp_of_unknown_direction_is_told() -> None:
    held = CableEnd(np.zeros((1, 3)), np.zeros(1), np.array([[1.0, 0.0, 0.0]]), np.zeros(1))
    nothing = CableEnds()
    told = warn_of(0.02, nothing)
    assert "20 mm" in told[0]
    assert "[cable.anchor] clamp_direction" in told[0]
    assert "[cable.end] clamp_direction" in warn_of(0.4, nothing)[0]
    assert warn_of(0.02, CableEnds(end=held)) == told
    for place, ends, method, more in [
        (0.2, nothing, "menger_gp", 1.0),
        (0.02, CableEnds(anchor=held), "menger_gp", 1.0),
        (0.4, CableEnds(end=held), "menger_gp", 1.0),
        (0.02, nothing, "menger_gp, elastica beside the clamps", 1.0),
        (0.02, nothing, "menger_gp", 0.1),
    ]:
        assert warn_of(place, ends, method, more) == []


def test_a_run_whose_cable_bends_most_at_its_clamp_says_so(tmp_path: Path) -> None:
    def bend(_: int, values: dict[str, Any]) -> dict[str, Any]:
        points = values["points_m"].copy()
        points[:, 1] += 0.8 * np.maximum(0.15 - points[:, 0], 0.0) ** 2
        return {**values, "points_m": points}

    spec = RunSpec(
        n_cycles=1,
        analysis='sorting = "chain"\ncurvature = "menger_gp"',
        anchor='kind = "static_marker"\nposition_m = [0.0, 0.018, 0.0]',
        change_points=bend,
    )
    results, _ = analyse(tmp_path, spec)
    assert [text for text in results.warnings if "The cable bends most" in text]
