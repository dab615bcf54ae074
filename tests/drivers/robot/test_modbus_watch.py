"""`bench check --watch` on a controller of each kind, and `mbpoll` on the simulated Modbus controller."""

from __future__ import annotations

import os
import pty
import select
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from modbus_bench import PATIENCE_S, SIMULATED, Rig, rig, wait_until

from bench.config import simulated_config_text
from bench.drivers.robot.modbus import ModbusSignalWatch
from bench.errors import ConnectError


@contextmanager
def watching(config: Path, stdout: int = subprocess.PIPE) -> Iterator[subprocess.Popen[str]]:
    """Run the command, and end it by Ctrl-C, which it must take for an orderly end."""
    command = [sys.executable, "-m", "bench", "check", "--watch", str(config)]
    process = subprocess.Popen(command, stdout=stdout, stderr=subprocess.PIPE, text=True)
    try:
        yield process
        process.send_signal(signal.SIGINT)
        _, said = process.communicate(timeout=30)
        assert (process.returncode, said) == (0, "")
    finally:
        process.kill()
        process.communicate()


def real_config(bench: Rig, folder: Path) -> Path:
    """Write the rig's configuration without [simulation], as for a controller that is really there."""
    path = folder / "plc.toml"
    text = SIMULATED.partition("[simulation]")[0].replace("127.0.0.61", bench.config.host)
    path.write_text(text, encoding="utf-8")
    return path


def read_until(process: subprocess.Popen[str], wanted: str) -> list[str]:
    assert process.stdout is not None
    lines: list[str] = []
    while wanted not in (line := process.stdout.readline()):
        assert line, f"{wanted!r} never came: {lines}"
        lines.append(line.strip())
    return [*lines, line.strip()]


def test_every_signal_is_a_line_and_a_line_again_when_it_changes(tmp_path: Path) -> None:
    with rig() as bench, watching(real_config(bench, tmp_path)) as process:
        lines = read_until(process, "guard door")
        assert lines[0] == "state = 0 (stopped)  [input 0 u16]"
        assert "speed_override = 1 (raw 100)  [input 7 u16]" in lines
        assert [line.partition(" = ")[0] for line in lines] == list(bench.config.map.signals)
        bench.controller.logic.open_interlocks.add("guard door")
        assert "interlock.guard door = 0 (open)  [discrete 2 bool]" in read_until(process, "guard door")
        bench.controller.server.exception_code = 4
        assert "exception 4, device failure" in read_until(process, "error = ")[-1]
        bench.controller.server.exception_code = 0
        assert bench.controller.tables.read_cells("holding")[:2] == [0, 0]


def test_in_a_terminal_the_signals_are_a_table(tmp_path: Path) -> None:
    main, side = pty.openpty()
    try:
        with rig() as bench, watching(real_config(bench, tmp_path), stdout=side):
            seen, deadline = b"", time.monotonic() + PATIENCE_S * 3
            while b"guard door" not in seen and time.monotonic() < deadline:
                if select.select([main], [], [], 0.1)[0]:
                    seen += os.read(main, 65_536)
            assert b"signal" in seen
            assert b"0 (stopped)" in seen
            assert b"guard door" in seen
    finally:
        os.close(main)
        os.close(side)


def test_a_simulated_ur_is_watched_by_its_main_fields(tmp_path: Path) -> None:
    path = tmp_path / "ur.toml"
    text = simulated_config_text().replace("127.0.0.21", "127.0.62.211").replace("127.0.0.22", "127.0.62.212")
    path.write_text(text, encoding="utf-8")
    with watching(path) as process:
        lines = read_until(process, "digital_outputs")
    assert "runtime_state = 1 (stopped)" in lines
    assert "robot_mode = 7 (running)" in lines
    assert "safety_status = 1 (normal)" in lines
    assert "cycle_count = 0" in lines
    assert "speed_slider = 100%" in lines


def test_nobody_to_watch_is_one_sentence() -> None:
    with rig() as bench:
        config = bench.config
    watch = ModbusSignalWatch(config, bench.clock)
    with pytest.raises(ConnectError, match="cannot be reached"):
        watch.open()
    watch.close()


@pytest.fixture
def mbpoll() -> str:
    """Return an independent Modbus client, from Debian; skip where it is absent."""
    found = shutil.which("mbpoll")
    if found is None:
        pytest.skip("mbpoll is not installed (Debian: apt install mbpoll)")
    return found


def poll(mbpoll: str, bench: Rig, *arguments: str) -> str:
    where = ["-m", "tcp", "-a", str(bench.config.unit_id), "-p", str(bench.config.port), "-0", "-1", *arguments]
    process = subprocess.run(
        [mbpoll, *where, bench.config.host], capture_output=True, text=True, timeout=20, check=False
    )
    return process.stdout + process.stderr


def test_mbpoll_reads_what_the_simulated_controller_shows(mbpoll: str) -> None:
    with rig() as bench:
        registers = poll(mbpoll, bench, "-t", "3", "-r", "0", "-c", "8")
        assert "[0]: \t0" in registers
        assert "[7]: \t100" in registers
        assert "[2]: \t0" in poll(mbpoll, bench, "-t", "3:float", "-B", "-r", "2")
        assert "[2]: \t1" in poll(mbpoll, bench, "-t", "1", "-r", "2")
        assert "Illegal data address" in poll(mbpoll, bench, "-t", "3", "-r", "500")


def test_mbpoll_starts_the_simulated_program_by_its_coil(mbpoll: str) -> None:
    with rig() as bench:
        start = [mbpoll, "-m", "tcp", "-p", "5020", "-0", "-t", "0", "-r", "0", bench.config.host, "1"]
        assert subprocess.run(start, capture_output=True, timeout=20, check=False).returncode == 0
        wait_until(lambda: bench.controller.logic.program.state == "PLAYING", "the program to play")
        assert "[0]: \t1" in poll(mbpoll, bench, "-t", "1", "-r", "0")
