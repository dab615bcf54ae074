"""`bench run --live`, watched by a real websocket client while cycles run, beside one that stalls."""

from __future__ import annotations

import json
import os
import re
import signal
import socket
import subprocess
import sys
import threading
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest
from bench_command import bench, one_sentence, simulated_file, start_bench
from live_client import LiveClient, stalled_client
from mcap.reader import make_reader

from bench.recording import Run, load_schema, open_run
from bench.recording.messages.cdr import decode

N_CYCLES = 20
ROOT = Path(__file__).parents[2]


@dataclass
class Watched:
    client: LiveClient
    run: Run
    printed: str

    def decoded(self, topic: str, schema: str) -> list[dict[str, Any]]:
        return [decode(load_schema(schema), payload) for _, payload in self.client.messages[topic]]


@pytest.fixture(scope="module")
def watched(tmp_path_factory: pytest.TempPathFactory) -> Watched:
    """Run 20 cycles once, watched by one client that reads and one that does not."""
    folder = tmp_path_factory.mktemp("live")
    client = LiveClient()
    with start_bench(
        "run", simulated_file(folder), "--cycles", str(N_CYCLES), "--speed", "10",
        "--output", folder / "a.mcap", "--live", "--live-port", "0",
    ) as process:  # fmt: skip
        assert process.stdout is not None
        url = process.stdout.readline().split()[-1]
        reading = threading.Thread(target=client.watch, args=(url,))
        reading.start()
        with stalled_client(url):
            printed, errors = process.communicate(timeout=120)
        reading.join(60)
    assert process.returncode == 0, errors + printed
    return Watched(client, open_run(folder / "a.mcap"), printed)


def test_the_recording_is_whole_whether_a_client_stalls_or_not(watched: Watched) -> None:
    assert f"{N_CYCLES} cycles" in watched.printed or f"{N_CYCLES} of {N_CYCLES}" in watched.printed
    assert watched.run.status.complete
    assert [stats.dropped + stats.missed for stats in watched.run.totals.values()] == [0] * len(watched.run.totals)
    assert watched.run.metadata["bench.cycles"] == {"completed": str(N_CYCLES)}


def test_the_counter_of_cycles_arrives_and_goes_up_to_the_last(watched: Watched) -> None:
    counts = [status["cycles_completed"] for status in watched.decoded("/live/status", "bench_msgs/msg/LiveStatus")]
    assert counts == sorted(counts)
    assert len(set(counts)) > 2
    assert counts[-1] == N_CYCLES


def test_the_status_says_why_there_is_no_cable_until_there_is_one(watched: Watched) -> None:
    problems = [status["cable"] for status in watched.decoded("/live/status", "bench_msgs/msg/LiveStatus")]
    assert problems[0] == "its static marker is looked for when the first cycle is completed"
    assert problems[-1] == ""


def test_markers_arrive_as_they_were_recorded_a_few_each_second(watched: Watched) -> None:
    recorded = {(message.log_time_ns, message.payload) for message in watched.run.messages(["/tracker/points"])}
    shown = watched.client.messages["/tracker/points"]
    assert len(recorded) > len(shown) > N_CYCLES
    assert set(shown) <= recorded


def test_state_changes_and_cycle_events_arrive_whole(watched: Watched) -> None:
    recorded = watched.run.messages(["/cycle/event", "/run/state"])
    shown = [*watched.client.messages["/cycle/event"], *watched.client.messages["/run/state"]]
    assert sorted(shown) == sorted((message.log_time_ns, message.payload) for message in recorded)


def test_the_curvature_is_the_reports_own(watched: Watched, tmp_path: Path) -> None:
    assert bench("report", watched.run.path, "--output", tmp_path / "a", "--mcap").returncode == 0
    shown = watched.decoded("/cable/curvature", "bench_msgs/msg/CableCurvature")
    numbers = [one["frame_number"] for one in shown]
    table = pq.read_table(tmp_path / "a" / "curvature.parquet", filters=[("frame_number", "in", numbers)]).to_pydict()
    values = zip(table["curvature_per_m"], table["sigma_per_m"], strict=True)
    report = dict(zip(table["frame_number"], values, strict=True))
    with (tmp_path / "a" / "derived.mcap").open("rb") as stream:
        derived = {one.sequence for _, _, one in make_reader(stream).iter_messages(topics=["/cable/curvature"])}
    assert len(shown) > N_CYCLES // 2
    for one in shown:
        # One second teaches a little else of how smooth the curvature is than the whole run does.
        curvature, sigma = (np.array(values) for values in report[one["frame_number"]])
        assert (np.abs(np.array(one["curvature_per_m"]) - curvature) < sigma).all()
        assert one["frame_number"] in derived
        assert one["min_bend_radius_mm"] == pytest.approx(1e3 / np.nanmax(one["curvature_per_m"]), rel=1e-5)


def test_the_cables_line_is_a_scene_of_foxgloves_own(watched: Watched) -> None:
    assert watched.client.channels["/cable/line"]["schemaName"] == "foxglove.SceneUpdate"
    assert len(watched.client.messages["/cable/line"]) == len(watched.client.messages["/cable/curvature"])


def test_every_other_channel_says_its_schema_as_the_run_file_does(watched: Watched) -> None:
    for topic, channel in watched.client.channels.items():
        if topic != "/cable/line":
            assert (channel["encoding"], channel["schemaEncoding"]) == ("cdr", "ros2msg")
            assert channel["schema"] == load_schema(channel["schemaName"]).text


def test_a_port_that_is_taken_ends_the_run_before_it_begins(tmp_path: Path) -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = str(taken.getsockname()[1])
        run = bench(
            "run", simulated_file(tmp_path), "--cycles", "1", "--output", tmp_path / "a.mcap",
            "--live", "--live-port", port,
        )  # fmt: skip
    assert f"127.0.0.1:{port}" in one_sentence(run, 3)
    assert not (tmp_path / "a.mcap").exists()


def test_without_the_library_one_sentence_says_what_to_install(tmp_path: Path) -> None:
    (tmp_path / "foxglove.py").write_text("raise ImportError('no such library')")
    active = tmp_path / "a.mcap.active"
    active.touch()
    command = [sys.executable, "-m", "bench", "live", str(active)]
    environment = {**os.environ, "PYTHONPATH": str(tmp_path)}
    live = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False, env=environment)
    assert "pip install 'cable-bench[live]'" in one_sentence(live, 2)


def test_the_view_ends_when_the_bench_that_started_it_is_gone(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "bench", "live", str(tmp_path / "a.mcap"), "--until-stdin-closes", "--port", "0"]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as view:
        assert view.stdin is not None
        assert view.stdout is not None
        assert view.stdout.readline().startswith(b"ready live ws://127.0.0.1:")
        view.stdin.close()
        assert view.wait(60) == 0


def test_ctrl_c_ends_the_view_of_a_run_that_goes_on(tmp_path: Path) -> None:
    active = tmp_path / "a.mcap.active"
    active.touch()
    with start_bench("live", active, "--port", "0") as view:
        assert view.stdout is not None
        view.stdout.readline()
        view.send_signal(signal.SIGINT)
        assert view.wait(60) == 0


def test_what_is_no_recording_is_not_followed(tmp_path: Path) -> None:
    (tmp_path / "a.mcap.active").write_text("a letter")
    assert "is not an MCAP file" in one_sentence(bench("live", tmp_path / "a.mcap.active", "--port", "0"), 5)


def test_a_finished_run_is_not_followed(watched: Watched) -> None:
    assert "is finished" in one_sentence(bench("live", watched.run.path), 5)


def test_the_layout_to_import_shows_topics_and_fields_that_are_served(watched: Watched) -> None:
    text = (ROOT / "bench_configs" / "lichtblick_live.json").read_text(encoding="utf-8")
    layout = json.loads(text)
    assert sorted(panels_of(layout["layout"])) == sorted(layout["configById"])
    named = re.findall(r'"(/[a-z]+/?[a-z]*)(?:\.(\w+)[^"]*)?"', text)
    assert len(named) == 7
    for topic, field in named:
        schema = watched.client.channels[topic]["schema"]
        assert not field or re.search(rf"\b{field}\b", schema)


def panels_of(node: str | dict[str, Any]) -> list[str]:
    return [node] if isinstance(node, str) else [*panels_of(node["first"]), *panels_of(node["second"])]
