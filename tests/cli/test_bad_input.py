"""Bad input to every command: one clear sentence, the right exit code, nothing overwritten, no orphan, no traceback."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from bench_command import bench, one_sentence, simulated_file, simulated_text
from mcap.writer import Writer


def test_an_unreachable_robot_and_tracker_are_both_named(tmp_path: Path) -> None:
    text = simulated_text().split("[simulation]")[0]
    config = tmp_path / "lab.toml"
    config.write_text(text)
    message = one_sentence(bench("run", config, "--cycles", "1", "--output", tmp_path / "a.mcap"), 3)
    robot, tracker = message.splitlines()[1:]
    assert robot.startswith("  - ")
    assert "30004" in robot
    assert "1510" in tracker
    assert list(tmp_path.glob("*.mcap*")) == []


def test_a_wrong_program_name(tmp_path: Path) -> None:
    # The simulated controller holds the program of its own configuration; the run asks for another.
    config = simulated_file(tmp_path)
    wrong = tmp_path / "wrong.toml"
    wrong.write_text(config.read_text().split("[simulation]")[0].replace("bend_test.urp", "bent_test.urp"))
    from bench_command import start_bench

    server = start_bench("simulate", config, "--speed", "10")
    try:
        assert server.stdout is not None
        assert [server.stdout.readline().split()[:2] for _ in range(2)] == [["ready", "robot"], ["ready", "tracker"]]
        message = one_sentence(bench("run", wrong, "--cycles", "1", "--output", tmp_path / "a.mcap"), 3)
        assert "bent_test.urp" in message
    finally:
        server.terminate()
        server.communicate(timeout=30)
    assert server.returncode == 0


def test_a_robot_in_local_mode(tmp_path: Path) -> None:
    config = simulated_file(tmp_path, ("[simulation]", "[simulation]\nremote_control = false"))
    message = one_sentence(bench("run", config, "--cycles", "1", "--output", tmp_path / "a.mcap"), 3)
    assert "remote control" in message.lower()
    assert list(tmp_path.glob("*.mcap*")) == []


def test_a_tracker_that_sees_no_markers(tmp_path: Path) -> None:
    config = simulated_file(tmp_path, ("[simulation]", "[simulation]\nmiss_probability = 1.0"))
    message = one_sentence(bench("run", config, "--cycles", "1", "--output", tmp_path / "a.mcap"), 4)
    assert "no markers" in message


def test_a_typo_in_the_configuration(tmp_path: Path) -> None:
    config = simulated_file(tmp_path, ("stretch = 0.02", "strech = 0.02"))
    message = one_sentence(bench("run", config, "--cycles", "1"), 2)
    assert "line" in message
    assert "did you mean 'stretch'?" in message


def test_an_output_that_exists_is_not_overwritten(tmp_path: Path) -> None:
    output = tmp_path / "a.mcap"
    output.write_bytes(b"precious")
    message = one_sentence(bench("run", simulated_file(tmp_path), "--cycles", "1", "--output", output), 5)
    assert "exists" in message
    assert output.read_bytes() == b"precious"


@pytest.mark.parametrize(
    "command",
    [
        ("run", "--cycles", "1"),
        ("check", "--cycle"),
        ("import", "take.csv", "--config", "cable.toml"),
        ("salvage", "run.mcap.active"),
    ],
)
def test_a_run_file_that_would_not_be_called_like_one(tmp_path: Path, command: tuple[str, ...]) -> None:
    message = one_sentence(bench(*command, "--output", tmp_path / "night.csv"), 2)
    assert "whose name ends in .mcap" in message
    assert f"--output {tmp_path / 'night.mcap'}" in message
    assert not list(tmp_path.iterdir())


def test_a_recording_is_not_imported_again(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    path.write_bytes(b"\x89MCAP0\r\n" + bytes(100))
    command = ("import", path, "--config", simulated_file(tmp_path), "--output", tmp_path / "b.mcap")
    message = one_sentence(bench(*command), 5)
    assert "it is a recording already" in message
    assert "bench report" in message


@pytest.mark.parametrize("command", ["report"])
def test_a_file_that_is_no_mcap(tmp_path: Path, command: str) -> None:
    path = tmp_path / "a.mcap"
    path.write_bytes(b"this is no recording" * 100)
    one_sentence(bench(command, path), 5)


def test_an_mcap_that_is_not_ours(tmp_path: Path) -> None:
    path = tmp_path / "other.mcap"
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start("other", "library")
        writer.finish()
    message = one_sentence(bench("report", path), 5)
    assert "bench" in message


def test_a_missing_run_file(tmp_path: Path) -> None:
    one_sentence(bench("report", tmp_path / "missing.mcap"), 5)


def test_cycles_must_be_given() -> None:
    process = bench("run")
    assert process.returncode == 2
    assert "--cycles" in process.stderr
    assert "Traceback" not in process.stderr


def test_speed_is_for_the_simulated_bench_only(tmp_path: Path) -> None:
    config = tmp_path / "lab.toml"
    config.write_text(simulated_text().split("[simulation]")[0])
    message = one_sentence(bench("run", config, "--cycles", "1", "--speed", "5"), 2)
    assert "--speed" in message


def test_a_simulated_bench_on_a_real_address_is_refused(tmp_path: Path) -> None:
    config = tmp_path / "lab.toml"
    config.write_text(re.sub(r"127\.\d+\.41\.", "192.0.2.", simulated_text()))
    one_sentence(bench("run", config, "--cycles", "1", "--output", tmp_path / "a.mcap"), 2)


def test_a_dry_run_touches_nothing(tmp_path: Path) -> None:
    config = simulated_file(tmp_path)
    process = bench("run", config, "--cycles", "1000", "--dry-run", "--output", tmp_path / "a.mcap")
    assert process.returncode == 0
    assert "2000 s" in process.stdout
    assert list(tmp_path.glob("*.mcap*")) == []
