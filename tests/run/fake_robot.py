"""A robot in the test's own process: implements the Protocols, moves only when the inbox waits."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable

from bench.errors import DeviceStateError, LinkLostError
from bench.model import DeviceInfo, Record, RobotState
from bench.run.inbox import Event, Fault
from bench.timing import ManualClock

PERIOD_NS = 40_000_000
STATES_PER_CYCLE = 10
TICKS_PER_WAIT = 6


class FakeRobot:
    """StateStream, SpeedControl and ProgramControl at once: a program of 10 states a cycle, begun by grants."""

    def __init__(self, clock: ManualClock) -> None:
        self.clock = clock
        self.sink: Callable[[Record], None] = lambda _record: None
        self.granted = 0
        self.count = 7  # what an earlier run left in the register
        self.step = -1.0
        self.playing = False
        self.stopped_calls = 0
        self.tick = 0
        self.at_tick: dict[int, Callable[[FakeRobot], None]] = {}
        self.link_broken = False
        self.is_heard = True
        self.paused = False
        self.safety_status = 1
        self.speed_fraction = 1.0
        self.slider_stuck = False
        self.slider_moves: list[float | None] = []
        """Everything that was asked of the speed slider, in order."""
        self.reasons: list[str] = []
        self.commands: list[str] = []
        """Everything that was asked of the program control, in order."""

    def open(self, sink: Callable[[Record], None]) -> DeviceInfo:
        self.sink = sink
        return DeviceInfo("robot", "fake", "nowhere", rate_hz=1e9 / PERIOD_NS)

    def grant_cycles(self, total: int) -> None:
        if self.link_broken:
            raise LinkLostError("The fake robot's link is broken.")
        self.granted = total

    def move_slider(self, fraction: float | None) -> None:
        if self.link_broken:
            raise LinkLostError("The fake robot's link is broken.")
        self.slider_moves.append(fraction)
        if fraction is not None:
            self.commands.append(f"slider {fraction:g}")
            self.speed_fraction = self.speed_fraction if self.slider_stuck else fraction

    @property
    def ready_when(self) -> str:
        return "nothing"

    def check(self, program: str) -> list[str]:
        self.commands.append("check")
        return self.reasons

    def load(self, program: str) -> None:
        if program != "bend_test.urp":
            raise DeviceStateError(f"no program {program}")

    def play(self) -> None:
        self.commands.append("play")
        self.playing, self.count, self.step = True, 0, -1

    def stop(self) -> None:
        self.commands.append("stop")
        self.playing = False
        self.stopped_calls += 1

    def close(self) -> None:
        self.playing = False

    def protective_stop(self) -> None:
        """Stop as the controller does by itself: the program is paused where it is."""
        self.paused, self.safety_status = True, 3

    def emergency_stop(self) -> None:
        self.playing, self.safety_status = False, 7

    def advance(self) -> None:
        self.clock.advance_ns(PERIOD_NS)
        self.tick += 1
        if self.playing and not self.paused:
            self._move()
        if action := self.at_tick.pop(self.tick, None):
            action(self)
        if self.is_heard:
            self.sink(self._state())

    def _move(self) -> None:
        if self.step < 0 and self.granted > self.count:
            self.step = 0
        elif self.step >= 0:
            self.step += self.speed_fraction
            if self.step >= STATES_PER_CYCLE - 1e-9:
                self.count, self.step = self.count + 1, -1

    def _state(self) -> RobotState:
        time_s = self.tick * PERIOD_NS * 1e-9
        return RobotState(
            arrival_ns=self.clock.now_ns(),
            capture_ns=self.clock.now_ns(),
            sequence=self.tick,
            segment=0,
            controller_time_s=time_s,
            runtime_state=(4 if self.paused else 2) if self.playing else 1,
            safety_status=self.safety_status,
            speed_fraction=self.speed_fraction,
            cycle_count=self.count,
            cycle_running=int(self.step >= 0),
        )


class PumpingInbox:
    """An inbox whose waiting makes the fake robot move."""

    def __init__(self, robot: FakeRobot) -> None:
        self.robot = robot
        self.events: deque[Event] = deque()

    def put(self, event: Event) -> None:
        self.events.append(event)

    def wait(self, deadline_ns: int) -> Event | None:
        for _ in range(TICKS_PER_WAIT):
            if self.events or self.robot.clock.now_ns() >= deadline_ns:
                break
            self.robot.advance()
        return self.events.popleft() if self.events else None

    def fail(self, error: Exception) -> None:
        self.put(Fault(error))
