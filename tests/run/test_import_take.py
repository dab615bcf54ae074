"""A take becomes a recording: what was in the one is in the other."""

from __future__ import annotations

import hashlib
import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader

from bench.config import Config, load_calibration, parse_config, to_toml
from bench.drivers.takes import read_take
from bench.errors import RecordingError, RecordingExistsError
from bench.model import NO_ID, StampKind
from bench.recording import Run, open_run
from bench.run.import_take import ImportSummary, import_take
from bench.timing import RunClock

DATA = Path(__file__).parents[1] / "drivers" / "takes" / "data"
MARKERS = DATA / "ha5dzs" / "test_markers_enabled.csv"
RIGID_BODY = DATA / "hmv" / "sample_optitrack_take.csv"
BEAM = DATA / "beam" / "beam_gravity_V2_a.c3d"
CONFIG = """
[cable]
length_m = 1.0
diameter_mm = 8.0
marker_arc_length_m = [0.1, 0.2, 0.3]
minimum_bend_radius_mm = 60.0
[cable.anchor]
kind = "ANCHOR"
"""
CALIBRATION = """
[calibration.measured]
run_file = "cal.mcap"
run_id = "a-1"
created_utc = "2026-11-22T06:00:00Z"
bench_version = "0.1.0"
[calibration.measured.time]
offset_ms = -4.6
offset_sd_ms = 0.01
[calibration.measured.space]
method = "rigid body"
lab_from_base_rotation_rad = [0.1, 0.2, 0.3]
lab_from_base_shift_m = [1.0, 2.0, 3.0]
lab_from_base_covariance = [ROW, ROW, ROW, ROW, ROW, ROW]
tcp_from_body_rotation_rad = [0.0, 0.0, 1.0]
tcp_from_body_shift_m = [0.0, 0.0, 0.1]
tcp_from_body_sd_mm = [0.01, 0.01, 0.01]
residual_rms_mm = 0.2
residual_max_mm = 0.5
n_frames = 100
n_outliers = 1
""".replace("ROW", str([0.0] * 6))
TRACKING_TOOLS = """righthanded
info,framecount,4
trackable,"pole",3,1,0.1,0.2,0.3
frame,0,0.00000000,1,3,1,2,3,0,0,0,1,0,0,0,2,0.1,0.2,0.3,0,0.4,0.5,0.6,0
frame,1,0.00400000,0,1,0.1,0.2,0.3,0
frame,2,0.00800000,0,0
"""


def make_config(anchor: str = "none", extra: str = "") -> Config:
    return parse_config(CONFIG.replace("ANCHOR", anchor) + extra, "test.toml")


def run_import(take: Path, folder: Path, config: Config | None = None) -> tuple[ImportSummary, Run]:
    """Import a take and open the recording."""
    settings = config or make_config()
    summary = import_take(take, settings, to_toml(settings), folder / "run.mcap", RunClock.start())
    return summary, open_run(folder / "run.mcap")


@pytest.mark.parametrize("path", [MARKERS, RIGID_BODY, BEAM], ids=["motive 1.23", "motive 1.21", "c3d"])
def test_every_point_of_a_take_is_in_its_recording(path: Path, tmp_path: Path) -> None:
    summary, run = run_import(path, tmp_path)
    points, frames = run["/tracker/points"], list(read_take(path).frames)
    assert summary.n_frames == len(frames) == len(points.offsets) - 1
    np.testing.assert_array_equal(points.offsets, np.cumsum([0, *(len(f.points_m) for f in frames)]))
    np.testing.assert_array_equal(points.points_m, np.concatenate([f.points_m for f in frames]))
    np.testing.assert_array_equal(points.ids, np.concatenate([f.ids for f in frames]))
    np.testing.assert_array_equal(points.flags, np.concatenate([f.flags for f in frames]))
    np.testing.assert_array_equal(points.residual_m, np.concatenate([f.residual_m for f in frames]))
    np.testing.assert_array_equal(points.capture_ns, [f.capture_ns for f in frames])
    np.testing.assert_array_equal(points.device_ticks, [f.device_ticks for f in frames])
    np.testing.assert_array_equal(points.frame_number, [f.frame_number for f in frames])


def test_the_calibration_travels_as_a_file_that_can_be_used_again(tmp_path: Path) -> None:
    config = make_config(extra=CALIBRATION)
    run_import(MARKERS, tmp_path, config)
    with (tmp_path / "run.mcap").open("rb") as stream:
        attached = {one.name: one.data for one in make_reader(stream).iter_attachments()}
    assert set(attached) == {"config.toml", "calibration.toml"}
    (tmp_path / "again.toml").write_bytes(attached["calibration.toml"])
    assert load_calibration(tmp_path / "again.toml") == config.calibration.measured


def test_a_recording_of_a_take_is_complete_and_says_that_it_is_one(tmp_path: Path) -> None:
    summary, run = run_import(MARKERS, tmp_path)
    assert run.status.complete
    assert run.exit_status == "import"
    assert run.config == make_config()
    about = run.metadata["bench.import"]
    assert about["file"] == MARKERS.name
    assert about["sha256"] == hashlib.sha256(MARKERS.read_bytes()).hexdigest()
    assert (about["frames_promised"], about["frames_found"]) == ("1353", "1353")
    totals = run.totals["/tracker/points"]
    assert (totals.written, totals.dropped, totals.missed) == (1353, 0, 0)
    assert len(run["/clock/sample"].log_time_ns) == 0  # nothing is known about the take's clock
    assert summary.bytes_written == summary.path.stat().st_size
    assert not summary.path.with_name("run.mcap.active").exists()


def test_the_device_tells_rate_bodies_names_and_offsets(tmp_path: Path) -> None:
    _, run = run_import(RIGID_BODY, tmp_path)
    (device,) = run.devices
    assert (device.device, device.kind, device.rate_hz) == ("tracker", "take", 120.0)
    assert device.version == "Motive CSV 1.21"
    assert device.bodies == {1: "Rigid Body 1"}
    assert len(json.loads(device.detail["body_markers"])["Rigid Body 1"]) == 3
    assert json.loads(device.detail["marker_names"])["0"] == "Unlabeled:108"
    assert device.detail["stamp"] == "frame_grid"
    bodies = run["/tracker/bodies"]
    assert len(bodies.log_time_ns) == 250


def test_a_tracking_tools_take_keeps_empty_frames_and_tells_what_is_missing(tmp_path: Path) -> None:
    path = tmp_path / "take.csv"
    path.write_text(TRACKING_TOOLS)
    summary, run = run_import(path, tmp_path)
    points = run["/tracker/points"]
    assert np.diff(points.offsets).tolist() == [2, 1, 0]
    assert (points.ids == NO_ID).all()
    assert (points.stamp == StampKind.FILE_TIME).all()
    assert points.capture_ns.tolist() == [0, 4_000_000, 8_000_000]
    assert summary.warnings == ("The header promises 4 frames, 3 were found.",)
    assert list(run["/log"].text) == list(summary.warnings)
    assert run.totals["/tracker/points"].missed == 1
    assert json.loads(run.devices[0].detail["body_markers"]) == {"pole": [[0.1, 0.2, 0.3]]}


def test_an_anchor_that_the_take_does_not_have_is_said(tmp_path: Path) -> None:
    summary, _ = run_import(RIGID_BODY, tmp_path, make_config("rigid_body", 'name = "pole"\n'))
    (warning,) = summary.warnings
    assert "cable.anchor is the rigid body 'pole', which the take does not have (it has 'Rigid Body 1')" in warning


def test_more_frames_than_the_queue_holds_are_all_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("bench.run.import_take.MAX_WAITING", 100)
    _, run = run_import(MARKERS, tmp_path)
    assert run.totals["/tracker/points"].written == 1353
    assert int(run.metadata["bench.end"]["queue_high_water"]) <= 102


def test_an_existing_output_is_refused_and_not_touched(tmp_path: Path) -> None:
    (tmp_path / "run.mcap").write_text("precious")
    with pytest.raises(RecordingExistsError):
        run_import(MARKERS, tmp_path)
    assert (tmp_path / "run.mcap").read_text() == "precious"
    assert [path.name for path in tmp_path.iterdir()] == ["run.mcap"]


def test_a_take_that_cannot_be_read_leaves_no_output(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match="without markers"):
        run_import(DATA / "ha5dzs" / "test_default.csv", tmp_path)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [("0.1,0.2,0.3,0\n", "0.1,0.2,o,0\n", "line 5: 'o' in column z"), ("frame,2", "frame,x", "line 6: 'x' in column")],
    ids=["while it is written", "before"],
)
def test_a_cell_that_is_no_number_leaves_no_output(old: str, new: str, said: str, tmp_path: Path) -> None:
    (tmp_path / "take.csv").write_text(TRACKING_TOOLS.replace(old, new))
    with pytest.raises(RecordingError, match=said):
        run_import(tmp_path / "take.csv", tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["take.csv"]


def test_a_take_without_a_single_point_leaves_no_output(tmp_path: Path) -> None:
    (tmp_path / "take.csv").write_text("info,framecount,2\nframe,0,0.0,0,0\nframe,1,0.1,0,0\n")
    with pytest.raises(RecordingError, match="no marker is seen in any of its 2 frames"):
        run_import(tmp_path / "take.csv", tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["take.csv"]


def test_an_import_that_fails_halfway_leaves_no_output(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def shrink(_writer: object, info: object) -> None:
        raise RecordingError("The disk is gone.")

    monkeypatch.setattr("bench.recording.RunWriter.add_device", shrink)
    with pytest.raises(RecordingError, match="The disk is gone"):
        run_import(MARKERS, tmp_path)
    assert list(tmp_path.iterdir()) == []


def test_a_recorder_that_fails_ends_the_import_with_its_own_error(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(_record: object) -> None:
        raise OSError(28, os.strerror(28))

    monkeypatch.setattr("bench.recording.writing.writer.RunWriter._write", lambda _self, record: fail(record))
    with pytest.raises(RecordingError, match="No space left on device") as caught:
        run_import(MARKERS, tmp_path)
    assert caught.value.exit_code == 5
    assert list(tmp_path.iterdir()) == []


def run_command(*arguments: str | Path, folder: Path) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "bench", "import", *map(str, arguments)]
    return subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False, timeout=120)


def test_the_command_says_what_it_imported_and_what_is_amiss(tmp_path: Path) -> None:
    (tmp_path / "c.toml").write_text(CONFIG.replace("ANCHOR", "none"))
    (tmp_path / "take.csv").write_bytes(MARKERS.read_bytes()[:-200])
    done = run_command("take.csv", "--config", "c.toml", "--output", "r.mcap", folder=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "1352 frames at 360 Hz, 15 to 18 points in each." in done.stdout
    assert "Next: bench report r.mcap" in done.stdout
    assert "warning: The header promises 1353 frames, 1352 were found." in done.stderr
    again = run_command("take.csv", "--config", "c.toml", "--output", "r.mcap", folder=tmp_path)
    assert again.returncode == 5
    assert "exists already and is not overwritten" in again.stderr
    assert "Traceback" not in again.stderr
