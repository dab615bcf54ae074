"""Opens the devices of one configuration, sends what they push where it belongs, and closes them."""

from __future__ import annotations

import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path

from bench.analysis import CycleFollower, make_cycle_source
from bench.config import AnyRobotConfig, AnyTrackerConfig, Config
from bench.drivers.base import ProgramControl, SpeedControl
from bench.drivers.flight import FlightRecorder
from bench.drivers.robot import make_program_control, make_state_stream
from bench.drivers.tracker import make_tracker
from bench.errors import BenchError, ConfigError, PreflightError
from bench.model import DeviceInfo, Record, RobotState, TrackerFrame
from bench.run.closing import Closing
from bench.run.conditions import ConditionKind, describe_lost_link
from bench.run.cycle_watcher import CycleWatcher
from bench.run.guards import Guards
from bench.run.inbox import ConditionCleared, ConditionRaised, Inbox
from bench.run.pace import PaceWatch
from bench.run.robot_words import make_robot_words
from bench.run.tally import FrameTally, RobotTally
from bench.run.utc_watch import UtcWatch
from bench.timing import Clock

__all__ = ["BenchLinks", "require_devices"]


def require_devices(config: Config) -> tuple[AnyRobotConfig, AnyTrackerConfig]:
    """Return both device tables; `ConfigError` naming those that are missing."""
    if config.robot is None or config.tracker is None:
        missing = [name for name in ("robot", "tracker") if getattr(config, name) is None]
        raise ConfigError(
            f"The configuration has no [{'] and no ['.join(missing)}] table, so nothing can be run with it.",
            hint="It is enough for bench import and bench report.",
        )
    return config.robot, config.tracker


class BenchLinks:
    """Robot and tracker of one configuration, and what has been seen of them.

    Parameters
    ----------
    config : Config
    clock : Clock
    inbox : Inbox
        Where cycle events and lost links go.
    record : callable
        Where every record goes: the run file.
    on_missed : callable, optional
        Told (topic, n) when a device's own sequence has a gap.
    free_bytes, written : callable, optional
        Free space on the run file's disk, and the size of the run file so far.
    first_cycle_index : int, optional
        Cycles of the run that is gone on with.
    packets : Path, optional
        Where the last packets go of a link that ends badly: ``PACKETS.robot-packets-1.txt``.
    """

    program: ProgramControl
    """Loads, starts and stops the program; there once the robot is open, for its version decides which it is."""

    def __init__(
        self,
        config: Config,
        clock: Clock,
        inbox: Inbox,
        record: Callable[[Record], None],
        on_missed: Callable[[str, int], None] | None = None,
        *,
        free_bytes: Callable[[], int] = lambda: sys.maxsize,
        written: Callable[[], int] = int,
        first_cycle_index: int = 0,
        packets: Path | None = None,
    ) -> None:
        robot, tracker = require_devices(config)
        self._robot_config, self._clock = robot, clock
        self._inbox = inbox
        self._record = record
        source = make_cycle_source(robot.cycle)
        self.watcher = CycleWatcher(
            inbox.put,
            record,
            first_cycle_index,
            ends_at_next=source is not None and source.ends_at_next,
            waiting=source.waiting if source else "",
        )
        self._follower = None if source is None else CycleFollower(source)
        self._utc_watch = UtcWatch(clock, record)
        self.robot_tally = RobotTally()
        self.frame_tally = FrameTally()
        self.pace = PaceWatch(clock)
        words = make_robot_words(robot)
        self.guards = Guards(config.policy, clock, inbox.put, record, free_bytes, written, first_cycle_index, words)
        self.stream = make_state_stream(
            robot,
            clock,
            on_missed=on_missed,
            on_lost=self._report_loss,
            on_restored=self._report_restored,
            reconnect_s=0.0 if config.policy.robot_link_lost == "abort" else config.policy.hold_timeout_s,
            moves_slider=config.run.first_cycle_speed < 1.0,
            flight=FlightRecorder("robot", clock, packets),
        )
        self.tracker = make_tracker(
            tracker, clock, on_missed=on_missed, flight=FlightRecorder("tracker", clock, packets)
        )

    @property
    def slider(self) -> SpeedControl | None:
        """The robot's speed slider, to be moved; None where it has none."""
        return self.stream if isinstance(self.stream, SpeedControl) else None

    def open(self, closing: Closing) -> list[DeviceInfo]:
        """Connect to everything, and report everything that cannot be reached at once.

        Raises
        ------
        DeviceError
            One device cannot be used.
        PreflightError
            More than one cannot.
        """
        closing.add("the robot's state stream", self.stream.close)
        closing.add("the tracker", self.tracker.close)
        infos: list[DeviceInfo] = []
        failures: list[BenchError] = []
        for connect in (partial(self._open_robot, closing), self._open_tracker):
            try:
                infos.append(connect())
            except BenchError as error:
                failures.append(error)
        if len(failures) == 1:
            raise failures[0]
        if failures:
            raise PreflightError([str(error) for error in failures], exit_code=failures[0].exit_code)
        return infos

    def _open_robot(self, closing: Closing) -> DeviceInfo:
        info = self.stream.open(self._take_robot_record)
        self.program = make_program_control(self._robot_config, self._clock, controller_version=info.version)
        closing.add("the robot's program control", self.program.close)
        self.program.open()
        return info

    def _open_tracker(self) -> DeviceInfo:
        info = self.tracker.open(self._take_tracker_record)
        self.frame_tally.nominal_rate_hz = info.rate_hz
        return info

    def _take_robot_record(self, record: Record) -> None:
        self._record(record)
        if isinstance(record, RobotState):
            self._utc_watch.update(record.arrival_ns)
            state = record if self._follower is None else self._follower.complete(record)
            self.watcher.update(state)
            self.robot_tally.update(state)
            self.pace.update(round(record.controller_time_s * 1e9), record.arrival_ns)
            self.guards.update_robot(state, self.pace.lag_ns)

    def _take_tracker_record(self, record: Record) -> None:
        self._record(record)
        if isinstance(record, TrackerFrame):
            self.frame_tally.update(record)
            self.guards.update_tracker(record.arrival_ns)

    def _report_loss(self, error: BenchError) -> None:
        self._inbox.put(ConditionRaised(describe_lost_link(error, self._clock.now_ns())))

    def _report_restored(self) -> None:
        self._inbox.put(ConditionCleared(ConditionKind.ROBOT_LINK_LOST))
