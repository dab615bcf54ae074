"""Starts the simulated bench as a process of its own, and always ends it.

The child reads its standard input and ends when that closes: a parent that is killed leaves no orphan.
"""

from __future__ import annotations

import socket
import subprocess
import sys
import tempfile
from pathlib import Path

from bench.config import Config, RobotConfig, to_toml
from bench.errors import ConfigError, ConnectError, LinkLostError
from bench.run.child import end_child, read_ready_lines
from bench.timing import RunClock

__all__ = ["SimulatorProcess", "with_free_addresses"]

READY_WITHIN_S = 60.0
"""Machine time for imports and the cable's shapes; 2 to 4 s on two slow cores, with room for a busy one."""
ENDS_WITHIN_S = 60.0
"""Machine time to write the rest of a truth file."""
DASHBOARD_PORT = 29999


class SimulatorProcess:
    """``bench simulate`` as a child process.

    Parameters
    ----------
    config : Config
        With a `[simulation]` table and loopback addresses.
    clock : RunClock
        Shared with the child, so that both sides live in the same time.
    truth : Path, optional
        Where the child writes what the simulated tracker knew.

    Raises
    ------
    ConfigError
        An address is not of this machine.
    """

    def __init__(self, config: Config, clock: RunClock, truth: Path | None = None) -> None:
        _verify_loopback(config)
        self._config = config
        self._clock = clock
        self._truth = truth
        self._folder: tempfile.TemporaryDirectory[str] | None = None
        self._process: subprocess.Popen[bytes] | None = None

    def start(self) -> list[str]:
        """Start the child and return its ready lines; `ConnectError` if it does not get ready."""
        self._folder = tempfile.TemporaryDirectory(prefix="bench-simulate-")
        folder = Path(self._folder.name)
        config_file = folder / "simulated.toml"
        config_file.write_text(to_toml(self._config), encoding="utf-8")
        command = [sys.executable, "-m", "bench", "simulate", str(config_file), "--clock", self._clock.to_text()]
        command += ["--until-stdin-closes", *(["--truth", str(self._truth)] if self._truth else [])]
        with (folder / "stderr").open("wb") as stderr:
            self._process = subprocess.Popen(
                command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=stderr, start_new_session=True
            )
        lines = read_ready_lines(self._process, 2, READY_WITHIN_S)
        if len(lines) < 2:
            said = (folder / "stderr").read_text(encoding="utf-8", errors="replace").strip()
            self.close()
            raise ConnectError(f"The simulated bench did not start: {said or 'it said nothing'}")
        return lines

    def verify_alive(self) -> None:
        """Raise `LinkLostError` if the child has ended by itself: nobody will start it again."""
        code = self._process.poll() if self._process is not None else None
        if code is not None:
            raise LinkLostError(
                f"The simulated bench has ended (exit code {code}).", hint="Go on with --resume, which starts another."
            )

    def close(self) -> None:
        """End the child: its input closes, and it is killed if that does not end it. May be called twice."""
        process, self._process = self._process, None
        if process is not None:
            end_child(process, ENDS_WITHIN_S)
        folder, self._folder = self._folder, None
        if folder is not None:
            folder.cleanup()


def with_free_addresses(config: Config) -> Config:
    """Return the simulated bench's configuration on loopback addresses that nobody serves yet.

    The packaged addresses come first; a second bench on the same machine moves on to the next pair.
    """
    robot, tracker = config.robot, config.tracker
    if not isinstance(robot, RobotConfig) or tracker is None:
        return config
    for last in range(21, 250, 2):
        hosts = f"127.0.0.{last}", f"127.0.0.{last + 1}"
        tracker_is_free = (
            _is_free(hosts[1], tracker.port)
            if tracker.kind == "qualisys"
            else _is_free(hosts[1], udp=tracker.command_port)
        )
        if tracker_is_free and _is_free(hosts[0], robot.rtde_port, DASHBOARD_PORT):
            update = {
                "robot": robot.model_copy(update={"host": hosts[0]}),
                "tracker": tracker.model_copy(update={"host": hosts[1]}),
            }
            return config.model_copy(update=update)
    return config


def _is_free(host: str, *tcp: int, udp: int | None = None) -> bool:
    wanted = [(socket.SOCK_STREAM, port) for port in tcp] + ([(socket.SOCK_DGRAM, udp)] if udp else [])
    for kind, port in wanted:
        with socket.socket(socket.AF_INET, kind) as probe:
            if kind == socket.SOCK_STREAM:
                probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            try:
                probe.bind((host, port))
            except OSError:
                return False
    return True


def _verify_loopback(config: Config) -> None:
    hosts = [("robot", config.robot), ("tracker", config.tracker)]
    for name, device in hosts:
        if device is None:
            raise ConfigError(f"A simulated bench needs a [{name}] table.")
        if not device.host.startswith("127."):
            raise ConfigError(
                f"[{name}] host = '{device.host}' is not an address of this machine, but [simulation] is given.",
                hint="Use 127.x.y.z for a simulated bench, or remove [simulation] for a real one.",
            )
