"""The run engine with a fake robot, a fake tracker and a manual clock."""

from __future__ import annotations

from fake_robot import FakeRobot, PumpingInbox

from bench.config import PolicyConfig
from bench.model import CycleEvent, CycleEventKind, LogEntry, Record, RobotState, RunState, StateChange
from bench.run.cycle_watcher import CycleWatcher
from bench.run.engine import RunEngine
from bench.run.first_cycle import FirstCycle
from bench.run.guards import Guards
from bench.run.holding import Holding
from bench.run.progress import RunLimits, RunProgress
from bench.run.states import RunStates
from bench.timing import ManualClock


class Setup:
    """An engine that is ready to run `n_cycles`."""

    def __init__(
        self,
        n_cycles: int,
        limits: RunLimits | None = None,
        policy: PolicyConfig | None = None,
        n_before: int = 0,
        first_cycle_speed: float = 1.0,
    ) -> None:
        self.clock = ManualClock()
        self.robot = FakeRobot(self.clock)
        self.inbox = PumpingInbox(self.robot)
        self.records: list[Record] = []
        self.watcher = CycleWatcher(self.inbox.put, self.records.append, n_before)
        self.free_bytes, self.bytes_per_cycle = 10**12, 0
        self.lag_ns = 0
        self.has_frames = True
        policy = policy or PolicyConfig()
        self.guards = Guards(
            policy,
            self.clock,
            self.inbox.put,
            self.records.append,
            lambda: self.free_bytes,
            lambda: self.bytes_per_cycle * self.robot.count,
            n_before,
        )
        self.robot.open(self._take)
        self.states = RunStates(self.clock, self.records.append)
        for state in (RunState.CONNECTING, RunState.CHECKING, RunState.ARMED):
            self.states.enter(state)
        self.progress = RunProgress(n_cycles, n_before)
        if first_cycle_speed < 1.0:
            self.robot.advance()  # the preflight has seen where the slider stands
        self.notes: list[str] = []
        self.engine = RunEngine(
            self.robot,
            self.robot,
            self.watcher,
            self.guards,
            Holding(policy, self.clock, self.records.append, lambda: self.robot.check("bend_test.urp")),
            self.inbox,
            self.states,
            self.clock,
            self.records.append,
            self.progress,
            limits or RunLimits(hold_s=policy.hold_timeout_s),
            FirstCycle(self.robot, first_cycle_speed, lambda: self.watcher.speed_fraction),
            refresh=self._note,
        )

    def _take(self, state: Record) -> None:
        if isinstance(state, RobotState):
            self.watcher.update(state)
            self.guards.update_robot(state, self.lag_ns)
            if self.has_frames:
                self.guards.update_tracker(state.arrival_ns)

    def _note(self) -> None:
        if not self.notes or self.notes[-1] != self.progress.note:
            self.notes.append(self.progress.note)

    def kinds(self, kind: CycleEventKind) -> list[int]:
        return [r.cycle_index for r in self.records if isinstance(r, CycleEvent) and r.kind == kind]

    def entered(self) -> list[RunState]:
        return [r.state for r in self.records if isinstance(r, StateChange)]

    def said(self) -> str:
        return "\n".join(r.text for r in self.records if isinstance(r, LogEntry))
