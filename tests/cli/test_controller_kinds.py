"""A run on each generation of controller, told apart by nothing but what the simulated one says on the wire."""

from __future__ import annotations

from pathlib import Path

import pytest
from bench_command import bench, one_sentence, simulated_file

from bench.recording import open_run


@pytest.mark.parametrize(
    ("controller", "version", "program"),
    [("cb3", "3.15.", {"loaded": "/programs/bend_test.urp"}), ("polyscope-x", "10.12.", {"loaded": "bend_test"})],
)
def test_a_cycle_is_run_and_recorded(tmp_path: Path, controller: str, version: str, program: dict[str, str]) -> None:
    config = simulated_file(tmp_path, ("[simulation]", f'[simulation]\ncontroller = "{controller}"'))
    run = bench("run", config, "--cycles", "1", "--speed", "8", "--output", tmp_path / "a.mcap")
    assert run.returncode == 0, run.stderr + run.stdout
    robot = next(device for device in open_run(tmp_path / "a.mcap").devices if device.device == "robot")
    assert robot.version.startswith(version)
    told = open_run(tmp_path / "a.mcap").metadata["bench.program"]
    assert program.items() <= told.items()
    assert ("loaded_sha256" in told) == (controller == "polyscope-x")


def test_polyscope_x_is_refused_while_it_is_in_local_control(tmp_path: Path) -> None:
    local = ("[simulation]", '[simulation]\ncontroller = "polyscope-x"\nremote_control = false')
    sentence = one_sentence(bench("check", simulated_file(tmp_path, local)), 3)
    assert "not in remote control" in sentence
    assert "safety overview of PolyScope X" in sentence
