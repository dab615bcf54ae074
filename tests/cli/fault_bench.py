"""A run on the simulated bench with a person at its pendant: faults by the admin channel, remedies by the dashboard."""

from __future__ import annotations

import json
import socket
import subprocess
import time
from collections.abc import Callable
from pathlib import Path

import psutil
from bench_command import start_bench

from bench.config import simulated_config_text

ADMIN_PORT = 29500
DASHBOARD_PORT = 29999
PATIENCE_S = 60.0


class FaultBench:
    """One run of `n_cycles`.

    Parameters
    ----------
    folder : Path
        Where its files go.
    host : str
        A loopback address for the robot that nobody else uses; the tracker has the one after it.
    speed : float
        Times real time.
    policy : str
        Lines of `[policy]`.
    changes : tuple of str
        What is replaced in the simulated bench's configuration, and by what.
    """

    def __init__(
        self,
        folder: Path,
        host: str,
        n_cycles: int,
        *changes: tuple[str, str],
        speed: float = 4.0,
        policy: str = "tracker_silence_s = 1.0",
    ) -> None:
        self.run_file = folder / "a.mcap"
        self._host = host
        first, last = host.rsplit(".", 1)
        text = simulated_config_text().replace("127.0.0.21", host).replace("127.0.0.22", f"{first}.{int(last) + 1}")
        text = text.replace("[simulation]", f"[simulation]\nadmin_port = {ADMIN_PORT}")
        for old, new in changes:
            assert old in text
            text = text.replace(old, new)
        config = folder / "simulated.toml"
        config.write_text(f"{text}\n[policy]\n{policy}\n", encoding="utf-8")
        self._process: subprocess.Popen[str] = start_bench(
            "run", config, "--cycles", str(n_cycles), "--speed", f"{speed:g}", "--output", self.run_file
        )

    def admin(self, command: str) -> None:
        assert self._say(ADMIN_PORT, command, banner=False) == "ok", command

    def told(self) -> list[str]:
        """Return what the robot was told so far, commands and grants."""
        admin = (self._host, ADMIN_PORT)
        with socket.create_connection(admin, timeout=PATIENCE_S) as link, link.makefile("rw") as lines:
            lines.write("told\n")
            lines.flush()
            told = []
            while (line := lines.readline()) != "ok\n":
                assert line, "the admin channel was closed"
                told.append(line.strip())
        return told

    def dashboard(self, command: str) -> str:
        return self._say(DASHBOARD_PORT, command, banner=True)

    def _say(self, port: int, command: str, *, banner: bool) -> str:
        with socket.create_connection((self._host, port), timeout=PATIENCE_S) as link, link.makefile("rw") as lines:
            if banner:
                lines.readline()
            lines.write(f"{command}\n")
            lines.flush()
            return lines.readline().strip()

    def journal(self) -> list[dict[str, object]]:
        path = self.run_file.with_name(f"{self.run_file.name}.journal")
        text = path.read_text() if path.exists() else ""
        return [json.loads(line) for line in text.splitlines(keepends=True) if line.endswith("\n")]

    def count(self, state: str) -> int:
        return sum(line.get("state") == state for line in self.journal())

    def n_completed(self) -> int:
        return max((int(str(line["completed"])) for line in self.journal() if "completed" in line), default=0)

    def wait(self, what: str, is_reached: Callable[[], bool]) -> None:
        deadline = time.monotonic() + PATIENCE_S
        while not is_reached():
            assert self._process.poll() is None, f"ended before: {what}: {self._process.communicate()}"
            assert time.monotonic() < deadline, f"not within {PATIENCE_S:g} s: {what}; {self.journal()[-3:]}"
            time.sleep(0.02)

    def wait_for_cycle(self) -> None:
        """Wait until another cycle is completed, and the next one is on its way."""
        n = self.n_completed()
        self.wait("a further cycle", lambda: self.n_completed() > n)
        time.sleep(0.15)  # a third of the next cycle

    def hold_and_go_on(self, fault: str, *remedies: Callable[[], object]) -> int:
        """Cause a hold, see it, remedy it, see the run go on; return how many cycles were completed at the hold."""
        self.wait_for_cycle()
        held, running = self.count("HOLDING"), self.count("RUNNING")
        self.admin(fault)
        self.wait(f"a hold after {fault}", lambda: self.count("HOLDING") > held)
        n_completed = self.n_completed()
        for remedy in remedies:
            assert self.count("RUNNING") == running, f"went on before {fault} was remedied"
            remedy()
        self.wait(f"the run goes on after {fault}", lambda: self.count("RUNNING") > running)
        return n_completed

    def kill_simulator(self) -> None:
        for child in psutil.Process(self._process.pid).children(recursive=True):
            child.kill()

    def unlock(self) -> None:
        """Release the protective stop as a person does at the pendant, and wait long enough for a wrong restart."""
        self.wait("5 s have passed", lambda: "releasing" in self.dashboard("unlock protective stop"))
        time.sleep(0.5)

    def finish(self) -> tuple[int, str, str]:
        """Wait for the end; return exit code, stdout, stderr."""
        out, err = self._process.communicate(timeout=PATIENCE_S)
        return self._process.returncode, out, err

    def close(self) -> None:
        if self._process.poll() is None:
            self._process.terminate()
            self._process.communicate(timeout=PATIENCE_S)
