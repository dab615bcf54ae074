"""A calibration file is checked like a configuration, and travels inside the configuration that names it."""

from pathlib import Path

import pytest

from bench.config import (
    Calibration,
    ClampCalibration,
    SpaceCalibration,
    SpacingCalibration,
    TimeCalibration,
    load_calibration,
    load_config,
    parse_config,
    simulated_config_text,
    to_toml,
)
from bench.errors import ConfigError

ZERO = (0.0,) * 6


def make_calibration() -> Calibration:
    return Calibration(
        run_file="cal.mcap",
        run_id="a-1",
        created_utc="2026-11-22T06:00:00Z",
        bench_version="0.1.0",
        time=TimeCalibration(offset_ms=-4.6, offset_sd_ms=0.01),
        space=SpaceCalibration(
            method="rigid body",
            lab_from_base_rotation_rad=(0.1, 0.2, 0.3),
            lab_from_base_shift_m=(1.0, 2.0, 3.0),
            lab_from_base_covariance=(ZERO, ZERO, ZERO, ZERO, ZERO, ZERO),
            tcp_from_body_rotation_rad=(0.0, 0.0, 1.0),
            tcp_from_body_shift_m=(0.0, 0.0, 0.1),
            tcp_from_body_sd_mm=(0.01, 0.01, 0.01),
            residual_rms_mm=0.2,
            residual_max_mm=0.5,
            n_frames=100,
            n_outliers=1,
        ),
        spacing=SpacingCalibration(marker_arc_length_m=(0.06, 0.18), sd_mm=(0.05, 0.07)),
        clamp=ClampCalibration(direction=(0.0, 0.0, 1.0), direction_sd_deg=0.3),
    )


def write_both(folder: Path, calibration: str) -> Path:
    (folder / "calibration.toml").write_text(calibration, encoding="utf-8")
    config = folder / "bench.toml"
    config.write_text(simulated_config_text() + '\n[calibration]\nfile = "calibration.toml"\n', encoding="utf-8")
    return config


def test_a_calibration_is_read_back_equal(tmp_path: Path) -> None:
    write_both(tmp_path, to_toml(make_calibration()))
    assert load_calibration(tmp_path / "calibration.toml") == make_calibration()


def test_the_file_is_found_beside_the_configuration_and_travels_in_it(tmp_path: Path, monkeypatch) -> None:
    monkeypatch.chdir("/")
    config = load_config(write_both(tmp_path, to_toml(make_calibration())))
    assert config.calibration.measured == make_calibration()
    assert config.calibration.offset_s == pytest.approx(-0.0046)
    (tmp_path / "calibration.toml").unlink()
    assert parse_config(to_toml(config), "the run") == config


def test_what_travels_in_a_configuration_counts_before_the_file(tmp_path: Path) -> None:
    config = load_config(write_both(tmp_path, to_toml(make_calibration())))
    resolved = tmp_path / "resolved.toml"
    resolved.write_text(to_toml(config), encoding="utf-8")
    (tmp_path / "calibration.toml").unlink()
    assert load_config(resolved) == config


def test_without_a_calibration_nothing_is_added(tmp_path: Path) -> None:
    path = tmp_path / "bench.toml"
    path.write_text(simulated_config_text(), encoding="utf-8")
    assert load_config(path).calibration.offset_s == 0.0


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("offset_ms = -4.6", "offset_s = -4.6", "offset_s is not a known key; the unit is part of the key"),
        ("format = 1", "format = 2", "format"),
        ("residual_rms_mm = 0.2", "residual_rms_mm = -0.2", "residual_rms_mm"),
        ("[time]", "[time", "not valid TOML"),
    ],
)
def test_a_fault_is_told_with_the_calibrations_own_name(tmp_path: Path, old: str, new: str, message: str) -> None:
    text = to_toml(make_calibration())
    assert old in text
    with pytest.raises(ConfigError, match=message) as caught:
        load_config(write_both(tmp_path, text.replace(old, new)))
    assert "calibration.toml" in str(caught.value)


def test_a_missing_calibration_is_one_sentence(tmp_path: Path) -> None:
    config = write_both(tmp_path, "")
    (tmp_path / "calibration.toml").unlink()
    with pytest.raises(ConfigError, match=r"The calibration .*calibration\.toml cannot be read: No such file"):
        load_config(config)


@pytest.mark.parametrize(
    ("table", "message"),
    [
        ('[cable.end]\nkind = "none"\nclamp_direction = [0.0, 0.0, 1.0]', "something that holds the cable"),
        ('[cable.end]\nkind = "tcp"\nclamp_direction = [0.0, 0.0, 0.0]', "any length but zero"),
        ('[cable.end]\nkind = "none"\nclamp_m = [0.0, 0.0, 1.0]', "clamp_m belongs to what moves"),
        ('[cable.end]\nkind = "tcp"\nname = "x"', "name belongs to kind = 'rigid_body'"),
    ],
)
def test_a_clamp_that_makes_no_sense_is_refused(table: str, message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        parse_config(f"{simulated_config_text()}\n{table}\n", "bench.toml")
