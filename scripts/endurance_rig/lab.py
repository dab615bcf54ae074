"""A simulated controller and tracker in a process, bench in another, and an operator who does what the screen says."""

from __future__ import annotations

import json
import re
import shlex
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

from bench.config import simulated_config_text

PATIENCE_S = 90.0
DASHBOARD_PORT = 29999
TO_GO_ON = re.compile(r"^To go on: (bench .*)$", re.MULTILINE)


@dataclass
class Fault:
    """What was done to bench or to the controller, and what came of it."""

    kind: str
    n_completed: int
    part: int
    """Number of the run file that was being written."""
    began_ns: int
    ended_ns: int = 0
    """Unix time at which a later cycle was completed."""
    told: list[str] = field(default_factory=list)
    """What the screen said to it, line by line."""
    outcome: str = ""
    named: list[str] = field(default_factory=list)
    """Where the reports name it."""


class Lab:
    """One test of `n_cycles`, as a chain of run files.

    Parameters
    ----------
    folder : Path
        Where all files go.
    host : str
        Loopback address of the controller; the tracker has the one after it.
    n_cycles, cycle_s, stall_s : int, float, float
        Cycles of the test, seconds of one, and of a stall.
    """

    def __init__(self, folder: Path, host: str, n_cycles: int, cycle_s: float, stall_s: float) -> None:
        self.n_cycles, self.cycle_s = n_cycles, cycle_s
        self._outputs: list[Path] = []
        self._folder, self._host, self._stall_s = folder, host, stall_s
        first, last = host.rsplit(".", 1)
        text = simulated_config_text().replace("127.0.0.21", host).replace("127.0.0.22", f"{first}.{int(last) + 1}")
        devices, simulation = text.split("[simulation]")
        self._config, self._simulation = folder / "lab.toml", folder / "controller.toml"
        # without [simulation] these are to bench the devices of a real laboratory
        self._config.write_text(devices, encoding="utf-8")
        simulation = re.sub(r"cycle_s = .*", f"cycle_s = {cycle_s}", simulation)
        self._simulation.write_text(f"{devices}[simulation]{simulation}", encoding="utf-8")
        self._controller: subprocess.Popen[str] | None = None
        self._bench: subprocess.Popen[bytes] | None = None

    @property
    def parts(self) -> list[Path]:
        """The run files so far, in order, as they lie on the disk."""
        return [path if path.exists() else path.with_name(f"{path.name}.active") for path in self._outputs]

    def start(self) -> None:
        """Start the controller, then bench."""
        self._start_controller()
        self._start_bench(["run", str(self._config), "--cycles", str(self.n_cycles)])

    def wait_for_cycles(self, n_completed: int, pause_s: float) -> None:
        """Wait until so many cycles are completed in all, and a little longer."""
        self._wait_until(lambda: self._is_running() and self._count() >= n_completed, f"{n_completed} cycles")
        time.sleep(pause_s)

    def suffer(self, kind: str) -> Fault:
        """Do it, do what the screen says, and return when another cycle is completed."""
        fault = Fault(kind, self._count(), len(self._outputs) - 1, time.time_ns())
        n_said = len(self._screen())
        what, _, whom = kind.partition(" ")
        victim = self._controller if whom == "controller" else self._bench
        if what == "kill":
            victim.kill()
            victim.wait(PATIENCE_S)
        else:
            victim.send_signal(signal.SIGSTOP)
            time.sleep(self._stall_s)
            victim.send_signal(signal.SIGCONT)
        if kind == "kill controller":
            victim.stdout.close()
            self._start_controller()
        fault.outcome = self._wait_for_outcome(must_end=what == "kill")
        fault.told = [line for line in self._screen()[n_said:].splitlines() if not line.startswith("cycle ")]
        if fault.outcome != "went on by itself":
            self._go_on()
        self._wait_for_another_cycle()
        fault.ended_ns = time.time_ns()
        return fault

    def finish(self) -> None:
        """Wait for the run to end with all its cycles."""
        code = self._bench.wait(PATIENCE_S + 2 * self.n_cycles * self.cycle_s)
        if code != 0:
            raise RuntimeError(f"bench ended with {code}:\n{self._screen()}")

    def close(self) -> None:
        """End what still runs."""
        for process in (self._bench, self._controller):
            if process is not None:
                process.kill()
                process.wait(PATIENCE_S)
        if self._controller is not None:
            self._controller.stdout.close()

    def _wait_for_outcome(self, *, must_end: bool) -> str:
        n_before = self._count()
        self._wait_until(
            lambda: self._bench.poll() is not None or (not must_end and self._count() > n_before + 1), "an outcome"
        )
        code = self._bench.poll()
        if code is None or code == 0:
            return "went on by itself"
        return f"{'killed' if code < 0 else f'ended with {code}'}, --resume"

    def _go_on(self) -> None:
        """Do what the screen says; where bench was killed, what the page about interrupted runs says."""
        command = TO_GO_ON.findall(self._screen())
        if command:
            self._start_bench(shlex.split(command[-1])[1:])
            return
        self._stop_program_at_pendant()
        self._start_bench(["run", "--cycles", str(self.n_cycles), "--resume", str(self.parts[-1])])

    def _wait_for_another_cycle(self) -> None:
        n_before = self._count()
        self._wait_until(lambda: self._bench.poll() == 0 or self._count() > n_before, "another cycle")

    def _stop_program_at_pendant(self) -> None:
        dashboard = (self._host, DASHBOARD_PORT)
        with socket.create_connection(dashboard, timeout=PATIENCE_S) as link, link.makefile("rw") as lines:
            lines.readline()
            lines.write("stop\n")
            lines.flush()
            lines.readline()

    def _start_controller(self) -> None:
        command = [sys.executable, "-m", "bench", "simulate", str(self._simulation)]
        self._controller = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
        for _device in ("robot", "tracker"):
            if not self._controller.stdout.readline().startswith("ready "):
                raise RuntimeError("the simulated controller did not start")

    def _start_bench(self, arguments: list[str]) -> None:
        output = self._folder / f"part{len(self._outputs)}.mcap"
        self._outputs.append(output)
        command = [sys.executable, "-m", "bench", *arguments, "--output", str(output)]
        with output.with_suffix(".txt").open("wb") as screen:
            self._bench = subprocess.Popen(command, stdout=screen, stderr=subprocess.STDOUT)

    def _screen(self) -> str:
        return self._outputs[-1].with_suffix(".txt").read_text(encoding="utf-8")

    def _journal(self) -> list[dict[str, object]]:
        path = self._outputs[-1].with_name(f"{self._outputs[-1].name}.journal")
        text = path.read_text(encoding="utf-8") if path.exists() else ""
        return [json.loads(line) for line in text.splitlines(keepends=True) if line.endswith("\n")]

    def _count(self) -> int:
        return max((int(str(line["completed"])) for line in self._journal() if "completed" in line), default=0)

    def _is_running(self) -> bool:
        states = [line["state"] for line in self._journal() if "state" in line]
        return states[-1:] == ["RUNNING"]

    def _wait_until(self, is_reached: Callable[[], bool], what: str) -> None:
        deadline = time.monotonic() + PATIENCE_S
        while not is_reached():
            if time.monotonic() > deadline or (what != "an outcome" and self._bench.poll() not in (None, 0)):
                raise RuntimeError(f"waited for {what} in vain:\n{self._screen()}")
            time.sleep(0.02)
