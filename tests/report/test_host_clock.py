"""A clock that is set in the middle of a run is told to the reader; one that NTP keeps is not."""

from __future__ import annotations

from pathlib import Path

import pytest

from bench.model import ClockSample, ClockSource
from bench.recording import RunWriter, open_run
from bench.report.host_clock import describe_host_clock, warn_of_steps
from bench.timing import ManualClock, RunClock


def write(path: Path, deviations_ns: list[int], speed: float = 1.0) -> Path:
    clock = ManualClock() if speed == 1.0 else RunClock.start(speed)
    writer = RunWriter(path, clock, config_toml="", versions={}, run_id="x")
    for k, away_ns in enumerate(deviations_ns):
        host_ns = 1_700_000_000_000_000_000 + k * 10_000_000_000
        writer.put(ClockSample(ClockSource.HOST, host_ns, host_ns + 200 + away_ns, host_ns + 400, 1e9))
    return writer.close(exit_status="success", reason="")


def test_a_step_is_told_with_its_size_and_a_slew_is_not(tmp_path: Path) -> None:
    slewed = open_run(write(tmp_path / "slewed.mcap", [0, 4_000_000, 8_000_000]))
    assert warn_of_steps(slewed) == []
    assert describe_host_clock(slewed) == "UTC moved against it by 8.00 ms at most, seen at 3 moments"
    stepped = open_run(write(tmp_path / "stepped.mcap", [0, 1_000, -1_500_000_000]))
    assert "by -1.500 s" in warn_of_steps(stepped)[0]


@pytest.mark.parametrize(("deviations", "speed"), [([], 1.0), ([0], 1.0), ([0, 10**9], 10.0)])
def test_without_pairs_or_at_simulated_speed_nothing_is_said(
    tmp_path: Path, deviations: list[int], speed: float
) -> None:
    run = open_run(write(tmp_path / "a.mcap", deviations, speed))
    assert warn_of_steps(run) == []
    assert describe_host_clock(run) == ""
