import os
import signal
import socket
import struct
import subprocess
import sys
from pathlib import Path

import numpy as np
import psutil
import pyarrow.parquet as pq
import pytest

from bench.cli.simulate import _say_lag, simulate
from bench.config import Config, simulated_config, to_toml
from bench.errors import ConfigError, ConnectError, RecordingExistsError
from bench.simulation.bench import SimulatedBench
from bench.timing import ManualClock, RunClock

PATIENCE_S = 60.0
"""Only a limit: nothing waits that long."""


def make_config(last, **changes):
    """Return the packaged configuration on loopback addresses that end in `last` and the next number."""
    config = simulated_config()
    robot = config.robot.model_copy(update={"host": f"127.0.33.{last}"})
    tracker = config.tracker.model_copy(update={"host": f"127.0.33.{last + 1}"})
    return config.model_copy(update={"robot": robot, "tracker": tracker, **changes})


def run_manually(config, seconds, truth=None, grants=2):
    """Let simulated time pass on a manual clock: as fast as the machine can, and always the same."""
    bench = SimulatedBench(config, ManualClock(), truth=truth)
    bench.open()
    try:
        bench.program.play()
        bench.robot.machine.write_inputs({"input_int_register_24": grants})
        bench.scheduler.call_at(ManualClock().now_ns() + round(seconds * 1e9), lambda _: bench.stop())
        bench.run()
    finally:
        bench.close()
    return bench


def test_robot_and_tracker_pass_through_the_same_simulated_time(tmp_path):
    bench = run_manually(make_config(11), 5.0, tmp_path / "truth.parquet")
    assert bench.program.motion_at(0).cycle_count == 2
    table = pq.read_table(tmp_path / "truth.parquet")
    assert table.num_rows == pytest.approx(500, abs=1)
    times = table["time_ns"].to_numpy()
    one_tick_ns = 302
    np.testing.assert_allclose(np.diff(times), 1e7 * (1 + 42e-6), atol=one_tick_ns)
    assert np.diff(times).mean() == pytest.approx(1e7 * (1 + 42e-6), abs=1.0)
    cycles, counts = np.unique(table["cycle_index"].to_numpy(), return_counts=True)
    assert cycles.tolist() == [-1, 0, 1]
    np.testing.assert_allclose(counts[1:], 200, atol=2)


def test_the_same_configuration_gives_the_same_truth(tmp_path):
    tables = []
    for name in ("a", "b"):
        run_manually(make_config(13), 1.0, tmp_path / name)
        tables.append(pq.read_table(tmp_path / name))
    a, b = (table.drop_columns("cycle_phase") for table in tables)  # its NaN equal nothing
    assert a.equals(b)
    np.testing.assert_array_equal(tables[0]["cycle_phase"].to_numpy(), tables[1]["cycle_phase"].to_numpy())


def test_the_robots_clock_is_off_as_configured():
    bench = run_manually(make_config(15), 4.0)
    passed = bench.robot.machine.values["timestamp"] - 61.25
    assert passed == pytest.approx(4.0 * (1 + 25e-6), abs=0.009)


@pytest.mark.parametrize("table", ["robot", "tracker"])
def test_a_configuration_without_a_device_is_refused(table):
    with pytest.raises(ConfigError, match=rf"needs a \[{table}\] table"):
        SimulatedBench(make_config(17, **{table: None}), ManualClock())


def test_without_a_simulation_table_its_defaults_hold():
    lines = []
    bench = SimulatedBench(make_config(19, simulation=None), RunClock.start())
    try:
        lines = bench.open()
    finally:
        bench.close()
    assert lines == [
        "ready robot ur 127.0.33.19 rtde=30004 dashboard=29999 program=bend_test.urp",
        "ready tracker natnet 127.0.33.20 command=1510 data=1511 rate_hz=100",
    ]


# From here on: the command, as a process.


def start(folder: Path, config: Config, *options: str) -> subprocess.Popen[str]:
    (folder / "bench.toml").write_text(to_toml(config), encoding="utf-8")
    command = [sys.executable, "-m", "bench", "simulate", str(folder / "bench.toml"), *options]
    pipe = subprocess.PIPE
    return subprocess.Popen(command, stdin=pipe, stdout=pipe, stderr=pipe, text=True)


def wait_for_a_frame(host: str) -> None:
    """Connect to the tracker as NatNet clients do and receive until a frame comes."""
    connect, frame_of_data = struct.pack("<HH", 0, 0), 7
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as link:
        link.settimeout(PATIENCE_S)
        link.sendto(connect, (host, 1510))
        while struct.unpack_from("<H", link.recv(65536))[0] != frame_of_data:
            pass


@pytest.fixture
def served(tmp_path, request):
    """Start a simulated bench with a truth file and read its two lines."""
    config = make_config(request.param)
    truth = tmp_path / "truth.parquet"
    with start(tmp_path, config, "--until-stdin-closes", "--truth", str(truth), "--speed", "20") as process:
        lines = [process.stdout.readline().strip() for _ in range(2)]
        yield process, lines, truth
        process.kill()


@pytest.mark.parametrize("served", [31], indirect=True)
def test_the_command_says_when_each_device_serves_and_ends_when_its_input_closes(served):
    process, lines, truth = served
    assert lines == [
        "ready robot ur 127.0.33.31 rtde=30004 dashboard=29999 program=bend_test.urp",
        "ready tracker natnet 127.0.33.32 command=1510 data=1511 rate_hz=100",
    ]
    with socket.create_connection(("127.0.33.31", 29999), PATIENCE_S) as link:
        assert b"Universal Robots Dashboard Server" in link.recv(200)
    wait_for_a_frame("127.0.33.32")
    rest, errors = process.communicate(timeout=PATIENCE_S)
    assert (process.returncode, rest, errors) == (0, "", "")
    assert pq.read_table(truth).num_rows > 0
    assert not truth.with_name("truth.parquet.active").exists()


@pytest.mark.parametrize(
    ("served", "number"), [(33, signal.SIGTERM), (35, signal.SIGINT)], indirect=["served"], ids=["TERM", "INT"]
)
def test_a_signal_ends_it_orderly(served, number):
    process, _, truth = served
    process.send_signal(number)
    process.wait(PATIENCE_S)
    assert process.returncode == 0
    assert pq.read_table(truth).num_rows >= 0


def test_it_does_not_outlive_a_parent_that_is_killed(tmp_path):
    (tmp_path / "bench.toml").write_text(to_toml(make_config(37)), encoding="utf-8")
    code = (
        "import subprocess, sys\n"
        "child = subprocess.Popen([sys.executable, '-m', 'bench', 'simulate', 'bench.toml', '--until-stdin-closes',\n"
        "                          '--truth', 'truth.parquet'],\n"
        "                         stdin=subprocess.PIPE, stdout=subprocess.PIPE, start_new_session=True)\n"
        "child.stdout.readline(), child.stdout.readline()\n"
        "print(child.pid, flush=True)\n"
        "child.wait()\n"
    )
    with subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True, cwd=tmp_path) as parent:
        child = psutil.Process(int(parent.stdout.readline()))
        os.kill(parent.pid, signal.SIGKILL)
    _, alive = psutil.wait_procs([child], PATIENCE_S)
    for process in alive:
        process.kill()
    assert alive == []
    assert pq.read_table(tmp_path / "truth.parquet").num_rows >= 0


def test_a_port_in_use_is_one_sentence_and_leaves_no_truth_file(tmp_path):
    options = ("--truth", str(tmp_path / "truth.parquet"))
    with socket.create_server(("127.0.33.39", 30004)), start(tmp_path, make_config(39), *options) as process:
        said, errors = process.communicate(timeout=PATIENCE_S)
    assert (process.returncode, said) == (3, "")
    assert "already in use" in errors
    assert len(errors.strip().splitlines()) == 1
    assert [path.name for path in tmp_path.iterdir()] == ["bench.toml"]


def test_a_trackers_port_in_use_closes_the_robot_again(tmp_path):
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
        other.bind(("127.0.33.42", 1510))
        bench = SimulatedBench(make_config(41), RunClock.start(), truth=tmp_path / "truth.parquet")
        with pytest.raises(ConnectError, match="already in use"):
            bench.open()
    assert list(tmp_path.iterdir()) == []
    with socket.create_server(("127.0.33.41", 30004)):
        pass


def test_an_existing_truth_file_is_refused(tmp_path):
    (tmp_path / "truth.parquet").write_text("mine")
    bench = SimulatedBench(make_config(43), RunClock.start(), truth=tmp_path / "truth.parquet")
    with pytest.raises(RecordingExistsError, match="not overwritten"):
        bench.open()


def test_a_cable_that_cannot_be_simulated_is_refused(tmp_path):
    config = make_config(45)
    long = config.cable.model_copy(update={"length_m": 50.0})
    with pytest.raises(ConfigError, match="length_m = 50 does not fit the simulated bench"):
        SimulatedBench(config.model_copy(update={"cable": long}), RunClock.start())


def test_a_clock_that_is_none_is_refused():
    with pytest.raises(ConfigError, match="'noon' is no clock"):
        simulate(clock="noon")


def test_a_machine_that_is_too_slow_is_told_so(capsys):
    clock = RunClock.start(speed=50.0)
    _say_lag(round(20e9), clock)
    assert capsys.readouterr().err == "This machine was up to 0.40 s too slow for --speed 50.\n"
    _say_lag(round(10e9), clock)
    assert capsys.readouterr().err == ""


def test_the_bench_lives_in_the_time_it_is_given(tmp_path):
    clock = RunClock(monotonic_ns=0, utc_ns=1_000_000_000_000_000_000, speed=10.0)
    truth = tmp_path / "truth.parquet"
    options = ("--clock", clock.to_text(), "--until-stdin-closes", "--truth", str(truth))
    with start(tmp_path, make_config(47), *options) as process:
        process.stdout.readline(), process.stdout.readline()
        wait_for_a_frame("127.0.33.48")
        process.communicate(timeout=PATIENCE_S)
    times = pq.read_table(truth)["time_ns"].to_numpy()
    now = clock.now_ns()
    assert len(times) > 0
    assert np.all((times < now) & (times > now - 10 * PATIENCE_S * 1e9))


def test_an_admin_port_is_named_and_obeyed():
    config = make_config(49)
    simulation = config.simulation.model_copy(update={"admin_port": 30099})
    bench = SimulatedBench(config.model_copy(update={"simulation": simulation}), RunClock.start())
    try:
        robot_line = bench.open()[0]
        with socket.create_connection(("127.0.33.49", 30099), PATIENCE_S) as link, link.makefile("r") as answers:
            link.sendall(b"local on\ntracker_stall 0.1\n")
            assert [answers.readline(), answers.readline()] == ["ok\n", "ok\n"]
        assert bench.robot.remote_control is False
    finally:
        bench.close()
    assert robot_line.endswith("dashboard=29999 admin=30099 program=bend_test.urp")


def test_the_trackers_data_port_is_the_one_its_table_names():
    config = make_config(50)
    tracker = config.tracker.model_copy(update={"data_port": 15_113})
    bench = SimulatedBench(config.model_copy(update={"tracker": tracker}), RunClock.start())
    try:
        assert "data=15113" in bench.open()[1]
    finally:
        bench.close()
