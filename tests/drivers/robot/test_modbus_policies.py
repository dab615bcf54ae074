"""What the policies make of a PLC's faults: the run engine on a simulated controller, over real sockets."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import pytest
from modbus_bench import Rig, rig, wait_until

from bench.config import PolicyConfig
from bench.drivers.robot.modbus import ModbusProgram, ModbusStateStream
from bench.errors import BenchError, CycleSequenceError, DeviceStateError, LinkLostError
from bench.model import CycleEvent, CycleEventKind, ExitStatus, LogEntry, Record, RobotState, RunState, StateChange
from bench.run.conditions import ConditionKind, describe_lost_link
from bench.run.cycle_watcher import CycleWatcher
from bench.run.engine import Ending, RunEngine, RunLimits, RunProgress
from bench.run.first_cycle import FirstCycle
from bench.run.guards import Guards
from bench.run.holding import Holding
from bench.run.inbox import ConditionCleared, ConditionRaised, QueueInbox
from bench.run.robot_words import make_robot_words
from bench.run.states import RunStates

COUNTS_ON = ('cycle_counter = { table = "input"', 'cycle_counter = { restarts = false, table = "input"')
SHORT = ("poll_rate_hz = 50", "poll_rate_hz = 50\nsilence_s = 0.6\ntimeout_s = 0.2\nretries = 0")
PATIENT = ("period_s = 0.5", "period_s = 10.0")
"""Our heartbeat: the controller does not pause for want of it."""
N_CYCLES = 5


class PlcRun:
    """A run of `N_CYCLES` on a rig, in a thread of its own; a tracker is taken for granted."""

    def __init__(self, plc: Rig, policy: PolicyConfig) -> None:
        self.plc = plc
        self.records: list[Record] = []
        self.notes: set[str] = set()
        config, clock = plc.config, plc.clock
        self._inbox = inbox = QueueInbox(clock)
        self._watcher = CycleWatcher(inbox.put, self.records.append)
        words = make_robot_words(config)
        self._guards = Guards(policy, clock, inbox.put, self.records.append, lambda: 10**12, int, words=words)
        self._stream = ModbusStateStream(
            config,
            clock,
            on_lost=lambda error: inbox.put(ConditionRaised(describe_lost_link(error, clock.now_ns()))),
            on_restored=lambda: inbox.put(ConditionCleared(ConditionKind.ROBOT_LINK_LOST)),
            reconnect_s=0.0 if policy.robot_link_lost == "abort" else 60.0,
        )
        self._program = ModbusProgram(config, clock)
        self._progress = RunProgress(N_CYCLES)
        states = RunStates(clock, self.records.append)
        for state in (RunState.CONNECTING, RunState.CHECKING, RunState.ARMED):
            states.enter(state)
        self._engine = RunEngine(
            self._program,
            self._stream,
            self._watcher,
            self._guards,
            Holding(policy, clock, self.records.append, lambda: self._program.check("path 3")),
            inbox,
            states,
            clock,
            self.records.append,
            self._progress,
            RunLimits(),
            FirstCycle(None, 1.0, lambda: float("nan")),
            refresh=lambda: self.notes.add(self._progress.note),
        )
        self._result: Ending | BenchError | None = None
        self._thread = threading.Thread(target=self._run, name="run")

    def _take(self, record: Record) -> None:
        self.records.append(record)
        if isinstance(record, RobotState):
            self._watcher.update(record)
            self._guards.update_robot(record, 0)
            self._guards.update_tracker(record.arrival_ns)

    def _run(self) -> None:
        try:
            self._result = self._engine.run()
        except BenchError as error:
            self._result = error

    def open(self) -> None:
        self._stream.open(self._take)
        self._program.open()
        wait_until(lambda: self._watcher.latest, "a state")
        self._thread.start()

    def close(self) -> None:
        self._thread.join()
        self._program.close()
        self._stream.close()

    def wait_for_cycle(self, n: int) -> None:
        wait_until(lambda: self.cycles(CycleEventKind.STARTED)[-1:] == [n], f"cycle {n} under way")

    def wait_for(self, state: RunState, n: int = 1) -> None:
        wait_until(lambda: sum(s is state for s in self.states()) >= n, f"{state} {n} times")

    def result(self) -> Ending | BenchError:
        self._thread.join(60.0)
        assert self._result is not None, "the run did not end"
        return self._result

    def cycles(self, kind: CycleEventKind) -> list[int]:
        return [r.cycle_index for r in list(self.records) if isinstance(r, CycleEvent) and r.kind is kind]

    def states(self) -> list[RunState]:
        return [r.state for r in list(self.records) if isinstance(r, StateChange)]

    def said(self) -> str:
        return "\n".join(r.text for r in list(self.records) if isinstance(r, LogEntry))


@contextmanager
def plc_run(*changes: tuple[str, str], cycle_s: float = 0.8, **policy: str) -> Iterator[PlcRun]:
    """Start a run, and end it whatever the test did."""
    limits = {"tracker_silence_s": 60.0, "hold_timeout_s": 120.0}
    with rig(SHORT, *changes, cycle_s=cycle_s) as plc:
        job = PlcRun(plc, PolicyConfig.model_validate(policy | limits))
        job.open()
        try:
            yield job
        finally:
            server = plc.controller.server
            server.delay_s, server.exception_code, server.is_frozen = 0.0, 0, False
            job.close()


def verify_all_cycles_once(job: PlcRun) -> None:
    ending = job.result()
    assert isinstance(ending, Ending), ending
    assert ending.status is ExitStatus.SUCCESS
    assert job.cycles(CycleEventKind.COMPLETED) == list(range(N_CYCLES))
    assert job.cycles(CycleEventKind.GRANTED) == list(range(N_CYCLES))


def test_bench_never_lets_a_program_go_on_that_the_controller_paused_for_want_of_its_heartbeat() -> None:
    with plc_run(("period_s = 0.5", "period_s = 0.1")) as job:
        job.wait_for_cycle(1)
        job.plc.controller.faults.freeze(True)
        job.wait_for(RunState.HOLDING)
        assert job.plc.controller.logic.program.state == "PAUSED"
        job.plc.controller.faults.freeze(False)
        wait_until(lambda: "Over: robot link lost." in job.said(), "the link is back")
        assert job.plc.controller.logic.program.state == "PAUSED"
        wait_until(lambda: any("resume it at the controller" in n.lower() for n in job.notes), "what to do")
        job.plc.controller.faults.resume()
        verify_all_cycles_once(job)
        assert job.cycles(CycleEventKind.INTERRUPTED) == [1]


def test_an_override_that_is_moved_holds_between_cycles_until_it_is_back() -> None:
    with plc_run(PATIENT) as job:
        job.wait_for_cycle(1)
        job.plc.controller.faults.set_override(0.5)
        job.wait_for(RunState.HOLDING)
        assert any("The speed override was moved from 100% to 50%." in note for note in job.notes)
        job.plc.controller.faults.set_override(1.0)
        verify_all_cycles_once(job)
        assert job.cycles(CycleEventKind.INTERRUPTED) == []


@pytest.mark.parametrize(
    ("policy", "cause", "words"),
    [
        ("safeguard_stop", lambda faults: faults.open_interlock("guard door"), "The interlock 'guard door' opened in"),
        ("robot_link_lost", lambda faults: faults.set_heartbeat(False), "The heartbeat of the Modbus controller"),
        ("slider_moved", lambda faults: faults.set_override(0.5), "The speed override was moved"),
    ],
)
def test_a_policy_to_stop_ends_the_run_after_the_cycle_and_the_program_is_stopped(
    policy: str, cause: Callable[[object], None], words: str
) -> None:
    with plc_run(PATIENT, ("max_age_s = 2.0", "max_age_s = 0.3"), **{policy: "stop"}) as job:
        job.wait_for_cycle(1)
        cause(job.plc.controller.faults)
        ending = job.result()
        assert isinstance(ending, Ending), ending
        assert ending.status is ExitStatus.ABORT
        assert f"stopped by the policy for this: {words}" in ending.reason
        n = len(job.cycles(CycleEventKind.COMPLETED))
        assert 2 <= n < N_CYCLES
        assert job.cycles(CycleEventKind.COMPLETED) == list(range(n))
        assert job.plc.controller.logic.program.state == "STOPPED"
        assert job.plc.controller.tables.read_cells("holding")[0] == n


@pytest.mark.parametrize(
    ("policy", "cause", "error", "words"),
    [
        ("safeguard_stop", lambda faults: faults.open_interlock("guard door"), DeviceStateError, "'guard door' opened"),
        ("robot_link_lost", lambda faults: faults.set_heartbeat(False), LinkLostError, "heartbeat of the Modbus"),
        ("emergency_stop", lambda faults: faults.set_fault(17), DeviceStateError, "in a fault .state 9, fault code 17"),
        ("program_replaced", lambda faults: faults.stop(), DeviceStateError, "The robot program stopped in cycle 1."),
        ("program_replaced", lambda faults: faults.set_counter(400), CycleSequenceError, "counter went from 1 to 400"),
        (
            "program_replaced",
            lambda faults: faults.reboot(),
            (DeviceStateError, CycleSequenceError),
            "stopped|from 1|restarted in cycle 1",
        ),
    ],
)
def test_what_aborts_the_run_withdraws_the_grant_stops_the_program_and_is_named(
    policy: str, cause: Callable[[object], None], error: type[Exception], words: str
) -> None:
    with plc_run(PATIENT, ("max_age_s = 2.0", "max_age_s = 0.3"), **{policy: "abort"}) as job:
        job.wait_for_cycle(1)
        cause(job.plc.controller.faults)
        ended = job.result()
        with pytest.raises(error, match=words):
            raise ended  # type: ignore[misc]  # an Ending here is a failure
        assert "pendant" not in str(ended)
        n = len(job.cycles(CycleEventKind.COMPLETED))
        assert job.cycles(CycleEventKind.COMPLETED) == list(range(n))
        assert job.cycles(CycleEventKind.INTERRUPTED) in ([], [n])  # it may fall between two cycles
        assert job.plc.controller.logic.program.state == "STOPPED"
        assert job.plc.controller.tables.read_cells("holding")[0] == 0
        assert job.plc.controller.tables.read_cells("coil")[:2] == [0, 0]


def test_a_frozen_controller_aborts_where_that_is_the_policy_without_a_hang() -> None:
    with plc_run(PATIENT, robot_link_lost="abort") as job:
        job.wait_for_cycle(1)
        job.plc.controller.faults.freeze(True)
        assert "gave no state for 0.6 s" in str(job.result())
        assert job.cycles(CycleEventKind.INTERRUPTED) == [1]


@pytest.mark.parametrize("changes", [(), (COUNTS_ON,)], ids=["restarts", "counts on over its end"])
def test_connections_that_break_at_any_moment_cost_no_cycle_and_count_none_twice(
    changes: tuple[tuple[str, str], ...],
) -> None:
    with plc_run(PATIENT, *changes) as job:
        done = threading.Event()
        while job.states()[-1] is not RunState.STOPPING and not done.wait(0.07):
            job.plc.controller.faults.drop()
            if isinstance(job._result, BenchError):
                break
        verify_all_cycles_once(job)
