"""The main fields of a UR's state, in words: for whoever sets the robot up."""

from __future__ import annotations

import threading
from collections.abc import Iterable, Sequence

from bench.config import RobotConfig
from bench.drivers.base import ShownSignal
from bench.drivers.robot.ur.state import UrStateStream
from bench.errors import LinkLostError
from bench.model import SAFETY_TEXTS, Record, RobotState
from bench.timing import Clock

__all__ = ["UrSignalWatch"]

FIRST_STATE_S = 3.0
"""Machine time: a controller sends 125 states a second, if it sends any."""
RUNTIME = ("stopping", "stopped", "playing", "pausing", "paused", "resuming")
"""UR runtime states (UR RTDE guide)."""
ROBOT_MODES = (
    "disconnected",
    "confirm safety",
    "booting",
    "power off",
    "powered, brakes locked",
    "idle",
    "backdrive",
    "running",
    "updating firmware",
)
"""UR robot modes (UR RTDE guide)."""
SAFETY_STATUSES = ("not told", *SAFETY_TEXTS.values())


class UrSignalWatch:
    """`SignalWatch` of a Universal Robots controller, by RTDE; no register is written or claimed."""

    def __init__(self, config: RobotConfig, clock: Clock) -> None:
        self._peer = f"controller {config.host}"
        cycle = config.cycle.model_copy(update={"grant": False})
        without_grant = config.model_copy(update={"cycle": cycle})
        self._stream = UrStateStream(without_grant, clock, on_lost=self._keep_loss)
        self._latest: RobotState | None = None
        self._lost: LinkLostError | None = None
        self._came = threading.Event()

    def open(self) -> None:
        """Connect; raises like `UrStateStream.open`."""
        self._stream.open(self._keep)

    def read(self) -> list[ShownSignal]:
        """Return the newest state. `LinkLostError` if there is none, or the link is lost."""
        self._came.wait(FIRST_STATE_S)
        if self._lost is not None:
            raise self._lost
        if self._latest is None:
            raise LinkLostError(f"The {self._peer} sent no state within {FIRST_STATE_S:g} s.")
        return _describe(self._latest)

    def close(self) -> None:
        """Close the connection. May be called twice."""
        self._stream.close()

    def _keep(self, record: Record) -> None:
        if isinstance(record, RobotState):
            self._latest = record
            self._came.set()

    def _keep_loss(self, error: LinkLostError) -> None:
        self._lost = error
        self._came.set()


def _describe(state: RobotState) -> list[ShownSignal]:
    shown = {
        "controller_time": f"{state.controller_time_s:.3f} s",
        "runtime_state": _named(state.runtime_state, RUNTIME),
        "robot_mode": _named(state.robot_mode, ROBOT_MODES),
        "safety_status": _named(state.safety_status, SAFETY_STATUSES),
        "speed_slider": f"{state.speed_fraction:.0%}",
        "cycle_count": f"{state.cycle_count}",
        "cycle_running": f"{state.cycle_running}",
        "cycle_phase": f"{state.cycle_phase:.4f}",
        "joints_rad": _join(state.q_rad),
        "tcp_pose": _join(state.tcp_pose),
        "digital_inputs": f"{state.digital_inputs:#x}",
        "digital_outputs": f"{state.digital_outputs:#x}",
    }
    return [ShownSignal(name, value) for name, value in shown.items()]


def _named(value: int, names: Sequence[str]) -> str:
    return f"{value} ({names[value] if 0 <= value < len(names) else 'unknown'})"


def _join(values: Iterable[float]) -> str:
    return " ".join(f"{value:.4f}" for value in values)
