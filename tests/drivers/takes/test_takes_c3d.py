"""C3D files: a real one, and ones written with ezc3d."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import ezc3d
import numpy as np
import pytest
from take_files import BEAM, read_all, write

from bench.drivers.takes import c3d, read_take
from bench.errors import RecordingError
from bench.model import UNLABELED, StampKind


def make_c3d(path: Path, points: np.ndarray[Any, Any], **parameters: list[Any]) -> Path:
    """Write (3, n, F) points; NaN is missing."""
    content = ezc3d.c3d()
    content["parameters"]["POINT"]["RATE"]["value"] = parameters.get("RATE", [120.0])
    content["parameters"]["POINT"]["LABELS"]["value"] = parameters.get(
        "LABELS", [f"m{i}" for i in range(points.shape[1])]
    )
    content["parameters"]["POINT"]["UNITS"]["value"] = parameters.get("UNITS", ["mm"])
    content["data"]["points"] = np.concatenate([points, np.ones((1, *points.shape[1:]))])
    content.write(str(path))
    return path


def test_a_real_c3d_file_has_its_named_markers_in_metres() -> None:
    take = read_take(BEAM)
    frames = list(take.frames)
    assert list(take.info.marker_names.values()) == [
        "Tip - 1",
        "Tip - 2",
        "Tip - 3",
        "Base - 1",
        "Base - 2",
        "Base - 3",
    ]
    assert (len(frames), take.info.frames_promised, take.info.rate_hz) == (500, 500, 100.0)
    assert [frame.device_ticks for frame in frames] == [i * 10_000_000 for i in range(500)]
    assert all(frame.stamp is StampKind.FRAME_GRID and frame.ids.tolist() == list(range(6)) for frame in frames)
    np.testing.assert_allclose(frames[0].points_m[0], [0.073983, 0.03062279, 0.07482155], atol=1e-8)
    assert 0.0002 < frames[0].residual_m[0] < 0.0004
    assert (frames[0].flags & UNLABELED).all()


def test_missing_points_are_left_out_and_ids_say_which_are_left(tmp_path: Path) -> None:
    points = np.arange(3.0 * 4 * 2).reshape(3, 4, 2)
    points[:, 1, 0] = np.nan
    take = read_take(make_c3d(tmp_path / "a.c3d", points))
    first, second = take.frames
    assert first.ids.tolist() == [0, 2, 3]
    assert second.ids.tolist() == [0, 1, 2, 3]
    np.testing.assert_allclose(first.points_m, points[:, [0, 2, 3], 0].T * 1e-3, rtol=1e-6)


def test_a_take_that_names_no_unit_is_in_millimetres_and_that_is_said(tmp_path: Path) -> None:
    take = read_take(make_c3d(tmp_path / "a.c3d", np.full((3, 1, 2), 1000.0), UNITS=[]))
    np.testing.assert_allclose(next(take.frames).points_m, [[1, 1, 1]])
    assert "millimetres are assumed" in take.info.warnings[0]


def test_an_unknown_unit_and_a_file_without_points_are_refused(tmp_path: Path) -> None:
    points = np.ones((3, 1, 2))
    with pytest.raises(RecordingError, match="length unit 'parsec'"):
        read_take(make_c3d(tmp_path / "a.c3d", points, UNITS=["parsec"]))
    with pytest.raises(RecordingError, match="no marker is seen in any of its 2 frames"):
        read_all(make_c3d(tmp_path / "c.c3d", points * np.nan))


def test_a_senseless_rate_is_refused(tmp_path: Path) -> None:
    rate = np.float32(100.0).tobytes()
    damaged = BEAM.read_bytes().replace(rate, np.float32(-5.0).tobytes())
    with pytest.raises(RecordingError, match=r"frame rate -5\.0 is no rate"):
        read_take(write(tmp_path, damaged, "a.c3d"))


@pytest.mark.parametrize(
    ("fault", "said"),
    [
        ("import os; os.abort()", "ezc3d ended with code -6"),
        ("import signal; signal.pause()", "ezc3d did not end within"),
        ("import sys; sys.exit('bad block')", "ezc3d says 'bad block'"),
    ],
)
def test_whatever_a_file_does_to_ezc3d_is_one_sentence(
    fault: str, said: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "faulty_worker.py").write_text(fault)
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    monkeypatch.setattr(c3d, "WORKER", "faulty_worker")
    monkeypatch.setattr(c3d, "LEAST_TIME_S", 0.2 if "pause" in fault else 60.0)
    with pytest.raises(RecordingError, match=f"beam_gravity_V2_a.c3d cannot be read: {said}"):
        read_take(BEAM)


@pytest.mark.parametrize("size", [2, 300, 511, 512, 514, 600, 3000, 3072, 40_000, 51_000])
def test_a_file_that_is_cut_off_is_refused_before_ezc3d_sees_it(size: int, tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match="the file ends before its header says"):
        read_take(write(tmp_path, BEAM.read_bytes()[:size], "cut.c3d"))


def test_what_a_c3d_file_holds_beyond_its_own_count_is_missed_and_said(tmp_path: Path) -> None:
    take = read_take(make_c3d(tmp_path / "a.c3d", np.ones((3, 1, 66_000))))
    assert take.info.frames_found == 65_535
    assert take.info.frames_promised is not None
    assert 65_535 < take.info.frames_promised <= 66_000
    (warning,) = take.info.warnings
    assert "65535 frames at most: some 4" in warning
    whole = read_take(make_c3d(tmp_path / "b.c3d", np.ones((3, 1, 65_535))))
    assert (whole.info.frames_promised, whole.info.warnings) == (65_535, ())


def test_points_in_two_units_are_refused(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match="its length unit is 'mm' and 'm'"):
        read_take(make_c3d(tmp_path / "a.c3d", np.ones((3, 1, 2)), UNITS=["mm", "m"]))


def test_the_axis_that_a_viewer_draws_upwards_is_told(tmp_path: Path) -> None:
    content = ezc3d.c3d(str(make_c3d(tmp_path / "a.c3d", np.ones((3, 1, 2)))))
    content.add_parameter("POINT", "Y_SCREEN", ["+Z"])
    content.write(str(tmp_path / "b.c3d"))
    assert read_take(tmp_path / "b.c3d").info.detail == {"up_axis": "z"}
