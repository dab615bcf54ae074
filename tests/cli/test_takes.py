"""Takes from real trackers, from the file to the report, as a user imports them."""

from __future__ import annotations

import os
import pty
import subprocess
import sys
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
from bench_command import bench, one_sentence, simulated_file
from truth import read_columns, score_sorting

from bench.recording import open_run

TAKES = Path(__file__).resolve().parents[1] / "drivers" / "takes" / "data"
CONFIG = """\
[cable]
length_m = 2.0
diameter_mm = 8.0
marker_count = 5
marker_spacing_m = 0.1
minimum_bend_radius_mm = 60.0

[cable.anchor]
kind = "none"
"""


def write_config(folder: Path) -> Path:
    path = folder / "take.toml"
    path.write_text(CONFIG)
    return path


def find_take(name: str) -> Path:
    return next(TAKES.rglob(name))


def test_a_motive_take_keeps_every_frame_on_the_exact_grid(tmp_path: Path) -> None:
    output = tmp_path / "take.mcap"
    take = find_take("test_markers_enabled.csv")
    process = bench("import", take, "--config", write_config(tmp_path), "--output", output)
    assert process.returncode == 0, process.stderr
    frames = open_run(output)["/tracker/points"]
    counts = np.diff(frames["offsets"])
    assert len(counts) == 1353
    assert (counts.min(), counts.max()) == (15, 18)
    ticks = frames["device_ticks"] if "device_ticks" in frames else open_run(output)["/tracker/frame"]["device_ticks"]
    exact = [round(i * 1_000_000_000 / 360) for i in range(1353)]
    assert (ticks - ticks[0]).tolist() == exact


def test_a_c3d_file_keeps_its_named_markers(tmp_path: Path) -> None:
    output = tmp_path / "beam.mcap"
    take = next(TAKES.rglob("*.c3d"))
    process = bench("import", take, "--config", write_config(tmp_path), "--output", output)
    assert process.returncode == 0, process.stderr
    (device,) = open_run(output).devices
    assert device.detail["marker_names"].count('"') >= 12


def test_a_take_without_markers_is_refused_and_leaves_nothing(tmp_path: Path) -> None:
    output = tmp_path / "take.mcap"
    take = find_take("test_default.csv")
    message = one_sentence(bench("import", take, "--config", write_config(tmp_path), "--output", output), 5)
    assert "without markers" in message
    assert list(tmp_path.glob("*.mcap*")) == []


def test_a_truncated_take_is_imported_up_to_the_cut_and_says_so(tmp_path: Path) -> None:
    whole = find_take("test_markers_enabled.csv").read_bytes()
    cut = tmp_path / "cut.csv"
    cut.write_bytes(whole[: len(whole) // 2])
    process = bench("import", cut, "--config", write_config(tmp_path), "--output", tmp_path / "cut.mcap")
    assert process.returncode == 0, process.stderr
    assert "1353" in process.stderr
    assert 600 < len(open_run(tmp_path / "cut.mcap")["/tracker/frame"]["frame_number"]) < 700


def test_sorted_markers_are_exported_and_never_over_a_file(tmp_path: Path) -> None:
    config, run = write_config(tmp_path), tmp_path / "take.mcap"
    (tmp_path / "straight.csv").write_text(
        "righthanded\ninfo,framecount,50\n"
        + "".join(
            f"frame,{i},{i / 100},0,5,{','.join(f'{0.1 * m},{0.3 + i / 1000},0,0' for m in (3, 0, 4, 1, 2))}\n"
            for i in range(50)
        )
    )
    assert bench("import", tmp_path / "straight.csv", "--config", config, "--output", run).returncode == 0
    done = bench("export", run, "--format", "trc", "--config", config)
    assert done.returncode == 0, done.stderr
    assert "take.trc: 5 markers in 50 frames, 100.0% of the positions found." in done.stdout
    assert len((tmp_path / "take.trc").read_text().splitlines()) == 6 + 50
    message = one_sentence(bench("export", run, "--format", "trc"), 5)
    assert "take.trc exists already" in message
    unknown = bench("export", run, "--format", "xls")
    assert unknown.returncode == 2
    assert "'csv', 'c3d', 'trc', 'parquet'" in " ".join(unknown.stderr.replace("│", " ").split())


def test_an_import_shows_its_progress_on_a_terminal_and_nowhere_else(tmp_path: Path) -> None:
    config, take = write_config(tmp_path), find_take("test_markers_enabled.csv")
    quiet = bench("import", take, "--config", config, "--output", tmp_path / "a.mcap")
    assert quiet.stderr == ""
    controller, terminal = pty.openpty()
    command = [sys.executable, "-m", "bench", "import", take, "--config", config, "--output", tmp_path / "b.mcap"]
    with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=terminal) as process:
        os.close(terminal)
        shown = b""
        try:
            while data := os.read(controller, 4096):
                shown += data
        except OSError:  # the other end is closed
            pass
        assert process.wait() == 0
    os.close(controller)
    assert b"checking" in shown
    assert b"writing" in shown


def test_an_import_never_overwrites(tmp_path: Path) -> None:
    output = tmp_path / "take.mcap"
    output.write_bytes(b"precious")
    take = find_take("test_markers_enabled.csv")
    one_sentence(bench("import", take, "--config", write_config(tmp_path), "--output", output), 5)
    assert output.read_bytes() == b"precious"


@pytest.mark.parametrize(("name", "least_exact"), [("clean", 0.999), ("hard", 0.25)])
def test_the_real_cable_is_sorted_as_its_truth_says(
    tmp_path: Path, shared_data: Path, name: str, least_exact: float
) -> None:
    # 'hard' holds what the paper's method is known to fail on; its score is a floor that must not fall.
    output, folder = tmp_path / "cable.mcap", tmp_path / "report"
    source = shared_data / "cable" / f"cable_a_{name}"
    imported = bench("import", f"{source}.csv", "--config", f"{source}.toml", "--output", output)
    assert imported.returncode == 0, imported.stderr
    report = bench("report", output, "--output", folder)
    assert report.returncode in (0, 1), report.stderr
    found = read_columns(folder / "markers.parquet")["source"]
    true = np.load(f"{source}.truth.npz")["source"]
    assert np.mean((found == true).all(axis=1)) >= least_exact


def test_misses_and_ghosts_cost_neither_frames_nor_counts_where_the_papers_method_loses_a_third(tmp_path: Path) -> None:
    config = simulated_file(
        tmp_path, ("[simulation]", '[simulation]\nmiss_probability = 0.05\nghost_count = 2\npoint_order = "shuffle"')
    )
    run, truth = tmp_path / "a.mcap", tmp_path / "truth.parquet"
    process = bench("run", config, "--cycles", "8", "--speed", "8", "--output", run, "--truth", truth)
    assert process.returncode == 0, process.stderr
    report = bench("report", run, "--output", tmp_path / "a")
    assert report.returncode == 0, report.stderr + report.stdout
    radius_mm = pq.read_table(tmp_path / "a" / "cycles.parquet")["min_bend_radius_mm"].to_numpy()
    assert radius_mm.min() > 100.0
    score = score_sorting(tmp_path / "a" / "markers.parquet", truth)
    assert score.exact > 0.99
    assert score.wrong < 0.005
    paper = tmp_path / "paper.toml"
    paper.write_text(f'{config.read_text()}\n[analysis]\nsorting = "paper"\n')
    # wrong labels of the paper's chain may look like a bend below the limit: exit code 1
    assert bench("report", run, "--config", paper, "--output", tmp_path / "p").returncode in (0, 1)
    # A chain that stops at a gap is exact only where nothing is hidden (0.95^10 = 60 %) or the last markers are.
    assert 0.5 < score_sorting(tmp_path / "p" / "markers.parquet", truth).exact < 0.75
    assert pq.read_table(tmp_path / "a" / "cycles.parquet").num_rows == 8
