"""A bench that is killed at any moment: with --resume its cycles add up, and none is counted twice.

``BENCH_KILLS=20 pytest tests/cli/test_resume_runs.py`` kills 20 times, and runs 200 cycles.
"""

from __future__ import annotations

import os
import random
import time
from pathlib import Path

import psutil
import pyarrow.parquet as pq
import pytest
from bench_command import bench, one_sentence, simulated_file, start_bench

from bench.config import simulated_config_text
from bench.recording import open_run

N_KILLS = int(os.environ.get("BENCH_KILLS", "3"))
N_CYCLES = 10 * N_KILLS
SPEED = "8"
PATIENCE_S = 90.0


def kill_after_cycles(command: list[str | Path], journal: Path, n_completed: int, pause_s: float) -> None:
    """Start a run, wait until its journal has that many cycles and a little longer, and kill it and what it started."""
    process = start_bench(*command)
    deadline = time.monotonic() + PATIENCE_S
    while not (journal.exists() and f'"completed": {n_completed}}}' in journal.read_text()):
        assert time.monotonic() < deadline, f"{journal} never had {n_completed} cycles"
        assert process.poll() is None, process.communicate()
        time.sleep(0.01)
    time.sleep(pause_s)
    children = psutil.Process(process.pid).children(recursive=True)
    process.kill()
    process.communicate(timeout=PATIENCE_S)
    assert psutil.wait_procs(children, timeout=PATIENCE_S)[1] == []


@pytest.fixture(scope="module")
def parts(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """Kill a run several times, go on each time, and end it in order; return its files in order."""
    folder = tmp_path_factory.mktemp("killed")
    chance = random.Random(os.environ.get("BENCH_KILL_SEED", "1"))
    config = folder / "simulated.toml"
    config.write_text(simulated_config_text().replace("127.0.0.2", "127.0.64.2"))
    files: list[Path] = []
    for number in range(N_KILLS + 1):
        path = folder / f"part{number}.mcap"
        command = ["run", config, "--cycles", str(N_CYCLES), "--speed", SPEED, "--output", path]
        command += ["--resume", files[-1]] if files else []
        if number == N_KILLS:
            process = bench(*command)
            assert process.returncode == 0, process.stderr + process.stdout
            files.append(path)
        else:
            n_before = (
                int(open_run(files[-1]).metadata.get("bench.resumed_from", {}).get("completed", 0)) if files else 0
            )
            n_wanted = max(n_before + chance.randint(1, 5), 10 * number + 1)
            kill_after_cycles(command, folder / f"{path.name}.journal", n_wanted, chance.uniform(0.0, 0.5))
            files.append(path.with_name(f"{path.name}.active"))
    return files


def completed_cycles(path: Path) -> list[int]:
    events = open_run(path)["/cycle/event"]
    return events.cycle_index[events.kind == 2].tolist()


def test_the_cycles_of_all_parts_add_up_and_none_is_there_twice(parts: list[Path]) -> None:
    expected_start = 0
    for path, following in zip(parts, [*parts[1:], None], strict=True):
        done = completed_cycles(path)
        assert done == list(range(expected_start, expected_start + len(done)))
        if following is None:
            assert expected_start + len(done) == N_CYCLES
            continue
        resumed = open_run(following).metadata["bench.resumed_from"]
        assert resumed["file"] == path.name
        assert resumed["run_id"] == open_run(path).run_id
        assert int(resumed["recorded"]) == expected_start + len(done) <= int(resumed["completed"])
        expected_start = int(resumed["completed"])


def test_only_the_last_part_has_no_journal_left(parts: list[Path]) -> None:
    assert not parts[-1].with_name(f"{parts[-1].name}.journal").exists()


def test_each_part_has_a_report_with_numbers_that_go_on(parts: list[Path], tmp_path: Path) -> None:
    process = bench("report", parts[-2], parts[-1], "--output", tmp_path / "reports")
    assert process.returncode in (0, 6), process.stderr
    before, after = (
        pq.read_table(table).to_pydict() for table in sorted((tmp_path / "reports").glob("*/cycles.parquet"))
    )
    assert after["cycle_index"][-1] == N_CYCLES - 1
    assert set(after["verdict"]) == {"ok"}
    ended = [i for i, verdict in zip(before["cycle_index"], before["verdict"], strict=True) if verdict != "interrupted"]
    assert max(ended, default=-1) < after["cycle_index"][0]


def test_a_run_with_all_its_cycles_is_not_resumed(parts: list[Path], tmp_path: Path) -> None:
    message = one_sentence(
        bench("run", "--cycles", str(N_CYCLES), "--resume", parts[-1], "--output", tmp_path / "x.mcap"), 4
    )
    assert "nothing is left to do" in message
    assert list(tmp_path.iterdir()) == []


def test_another_cable_is_not_the_same_test(parts: list[Path], tmp_path: Path) -> None:
    config = simulated_file(tmp_path, ("length_m = 1.20", "length_m = 1.21"))
    message = one_sentence(bench("run", config, "--cycles", "999", "--resume", parts[0]), 2)
    assert "cable.length_m" in message
