"""The main job, end to end: run, record, report, over real sockets, scored against the simulated bench's truth."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest
from bench_command import bench, one_sentence, run_and_report, simulated_file
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from truth import join_truth, score_sorting

from bench.recording import open_run

N_CYCLES = 20
PROGRAM = bytes(range(256))


@pytest.fixture(scope="module")
def job(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Run 20 cycles and their report once, for all tests of this module."""
    folder = tmp_path_factory.mktemp("job")
    config = simulated_file(folder, ("[robot]\n", '[robot]\nprogram_file = "bend v3.urp"\n'))
    (folder / "bend v3.urp").write_bytes(PROGRAM)
    run_and_report(folder, config, N_CYCLES, speed=8)
    return folder


def decode_independently(path: Path, topic: str) -> list[Any]:
    with path.open("rb") as stream:
        messages = make_reader(stream, decoder_factories=[DecoderFactory()]).iter_decoded_messages(topics=[topic])
        return [message for _, _, _, message in messages]


def test_every_cycle_is_one_row_with_verdict_ok(job: Path) -> None:
    cycles = pq.read_table(job / "a" / "cycles.parquet").to_pydict()
    assert cycles["cycle_index"] == list(range(N_CYCLES))
    assert cycles["verdict"] == ["ok"] * N_CYCLES
    assert all(2.0 <= duration < 2.2 for duration in cycles["duration_s"])


def test_the_run_file_names_the_libraries_that_spoke_to_the_devices(job: Path) -> None:
    assert {"cable-bench", "httpx", "mcap", "numpy", "pymodbus"} <= open_run(job / "a.mcap").versions.keys()


def test_the_run_file_holds_what_was_checked_before_it_and_which_program_was_loaded(job: Path) -> None:
    checked = open_run(job / "a.mcap").metadata["bench.preflight"]
    assert checked["program loaded"] == "ok: bend_test.urp"
    assert {"robot ready", "robot rate", "tracker rate", "markers", "disk space"} <= checked.keys()


def test_the_program_that_was_named_travels_with_its_hash_and_is_told_everywhere(job: Path) -> None:
    run, digest = open_run(job / "a.mcap"), hashlib.sha256(PROGRAM).hexdigest()
    assert run.read_attachment("program.urp") == PROGRAM
    assert run.metadata["bench.program"]["sha256"] == digest
    told = f"bend v3.urp, 256 bytes, SHA-256 {digest}"
    assert run.metadata["bench.preflight"]["program file"] == f"ok: {told}"
    assert json.loads((job / "a" / "summary.json").read_text())["run_facts"]["Program file"] == told
    assert told in (job / "a" / "report.html").read_text()
    assert told in bench("info", job / "a.mcap").stdout


def test_a_run_does_not_go_on_with_another_program(job: Path, tmp_path: Path) -> None:
    config = simulated_file(tmp_path, ("[robot]\n", '[robot]\nprogram_file = "bend v3.urp"\n'))
    (tmp_path / "bend v3.urp").write_bytes(PROGRAM + b".")
    again = bench("run", config, "--cycles", "40", "--resume", job / "a.mcap", "--output", tmp_path / "b.mcap")
    assert "was another test, with another program" in one_sentence(again, 2)
    assert not list(tmp_path.glob("b.mcap*"))


def test_run_file_and_report_say_how_well_the_cycles_times_are_known(job: Path) -> None:
    accuracy = "starts and ends are known to one robot sample, and no count can be lost; a sample comes every 8 ms"
    recorded = open_run(job / "a.mcap").metadata["bench.cycle_source"]
    assert recorded == {"source": "robot's counter", "accuracy": accuracy}
    facts = json.loads((job / "a" / "summary.json").read_text())["run_facts"]
    assert facts["Cycle source"] == f"robot's counter: {accuracy}"


def test_nothing_is_missing_on_the_controllers_time_grid(job: Path) -> None:
    time_s = open_run(job / "a.mcap")["/robot/state"]["controller_time_s"]
    steps = np.rint(np.diff(time_s) * 125.0)
    assert np.all(steps == 1)


def test_no_tracker_frame_is_missing(job: Path) -> None:
    numbers = open_run(job / "a.mcap")["/tracker/points"]["frame_number"]
    assert np.all(np.diff(numbers) == 1)


def test_an_independent_decoder_reads_the_same(job: Path) -> None:
    run = open_run(job / "a.mcap")
    states = decode_independently(job / "a.mcap", "/robot/state")
    columns = run["/robot/state"]
    assert len(states) == len(columns["controller_time_s"])
    assert [s.controller_time_s for s in states] == columns["controller_time_s"].tolist()
    assert [s.cycle_count for s in states] == columns["cycle_count"].tolist()
    points = run["/tracker/points"]
    clouds = decode_independently(job / "a.mcap", "/tracker/points")
    assert [c.width for c in clouds] == np.diff(points["offsets"]).tolist()
    first = np.frombuffer(bytes(clouds[0].data), dtype="<f4").reshape(clouds[0].width, -1)[:, :3]
    np.testing.assert_array_equal(first, points["points_m"][: clouds[0].width])


def test_without_misses_and_ghosts_the_sorting_is_exact_in_every_frame(job: Path) -> None:
    score = score_sorting(job / "a" / "markers.parquet", job / "truth.parquet")
    assert score.n_frames > N_CYCLES * 190
    assert score.exact == 1.0


def test_cycle_index_and_phase_agree_with_the_truth(job: Path) -> None:
    joined = join_truth(job / "a" / "markers.parquet", job / "truth.parquet")
    inside = (joined["cycle_index"] >= 0) & (joined["cycle_index_true"] >= 0)
    # A frame within one controller period of a cycle's edge may fall on either side of it.
    assert np.mean(joined["cycle_index"] == joined["cycle_index_true"]) > 0.99
    assert np.all(joined["cycle_index"][inside] == joined["cycle_index_true"][inside])
    assert np.max(np.abs(joined["cycle_phase"][inside] - joined["cycle_phase_true"][inside])) < 0.02


def test_capture_times_agree_with_the_truth(job: Path) -> None:
    joined = join_truth(job / "a" / "markers.parquet", job / "truth.parquet")
    error_ns = joined["time_ns"] - joined["time_ns_true"]
    # At 8 times real time a millisecond of this machine is 8 of the clock's.
    assert np.median(np.abs(error_ns)) < 10_000_000


def test_the_summary_says_what_the_tables_say(job: Path) -> None:
    summary = json.loads((job / "a" / "summary.json").read_text())
    assert summary["outcome"] == "PASS"


def test_the_report_never_overwrites(job: Path) -> None:
    before = (job / "a" / "report.html").read_bytes()
    again = bench("report", job / "a.mcap", "--output", job / "a")
    assert again.returncode == 5, again.stderr
    assert (job / "a" / "report.html").read_bytes() == before
