"""Watch what the devices send, and the disk, for conditions a run must not go on in. They judge; the engine acts.

The robot's and the tracker's guard are fed by reader threads, all are asked by the engine's. None ever commands.
"""

from __future__ import annotations

from collections.abc import Callable

from bench.config import PolicyConfig
from bench.errors import DeviceError, DiskFullError, LinkLostError
from bench.model import Record, RobotState
from bench.run.conditions import ROBOT_STOPS, Condition, ConditionKind
from bench.run.cycle_watcher import PLAYING
from bench.run.inbox import ConditionCleared, ConditionRaised, Event
from bench.run.own_pause import OwnPause
from bench.run.robot_words import UR_WORDS, RobotWords
from bench.timing import Clock, patience_ns

__all__ = ["Guards"]

STOPPED, PAUSED = 1, 4
"""UR runtime states (UR RTDE guide)."""
SAFETY_KINDS = {
    3: ConditionKind.PROTECTIVE_STOP,
    5: ConditionKind.SAFEGUARD_STOP,
    12: ConditionKind.SAFEGUARD_STOP,
    13: ConditionKind.SAFEGUARD_STOP,
    6: ConditionKind.EMERGENCY_STOP,
    7: ConditionKind.EMERGENCY_STOP,
    8: ConditionKind.EMERGENCY_STOP,
    9: ConditionKind.EMERGENCY_STOP,
}
"""By UR safety status (UR RTDE guide); a violation and a fault end the program as an emergency stop does."""
ADVICE = {
    ConditionKind.PROTECTIVE_STOP: "Look at robot and cable, clear the stop at {panel}, resume the program there.",
    ConditionKind.SAFEGUARD_STOP: "{close_safeguard}; if the program stays paused, resume it at {panel}.",
    ConditionKind.EMERGENCY_STOP: "Clear it at the robot, then go on with --resume.",
    ConditionKind.PROGRAM_PAUSED: "Resume it at {panel}, or press Ctrl-C twice to abort.",
    ConditionKind.PROGRAM_REPLACED: "See {panel} for the reason, clear it there, then go on with --resume.",
}
"""In the words of the robot, see `bench.run.robot_words`."""
SLIDER_STEP = 0.005
"""The slider moves in whole per cents."""
LAG_WINDOW_S = 1.0
"""Machine time in which one package in good time is enough: only a link that queues is late with all of them."""
DISK_PERIOD_S = 1.0
FORECAST_CYCLES = 5
"""Cycles measured before the run's size is foretold: the file grows in steps of one second."""

Notify = Callable[[Event], None]


class Switch:
    """Tells each change of one judgement, once."""

    def __init__(self, notify: Notify) -> None:
        self._notify = notify
        self.told: Condition | None = None

    def set(self, condition: Condition | None) -> None:
        """Tell `condition` if it is news; None: that there is none any more."""
        before, self.told = self.told, condition
        if before is not None and (condition is None or condition.kind is not before.kind):
            self._notify(ConditionCleared(before.kind))
        if condition is not None and (
            before is None or (before.kind, before.advice) != (condition.kind, condition.advice)
        ):
            self._notify(ConditionRaised(condition))


class RobotGuard:
    """Safety stops, pauses, and the speed slider, from the robot's state stream."""

    def __init__(self, notify: Notify, first_cycle_index: int = 0, words: RobotWords = UR_WORDS) -> None:
        self._first_cycle_index = first_cycle_index
        self._words = words
        self._stop = Switch(notify)
        self._slider = Switch(notify)
        self._speed_fraction = float("nan")

    def expect_speed(self, fraction: float) -> None:
        """Take `fraction` as the slider's place from here on; NaN: any."""
        self._speed_fraction = fraction

    def update(self, state: RobotState) -> None:
        self._stop.set(self._judge_stop(state))
        self._slider.set(self._judge_slider(state))

    def _judge_stop(self, state: RobotState) -> Condition | None:
        kind = SAFETY_KINDS.get(state.safety_status)
        if kind is not None:
            return self._stopped(kind, state, self._words.describe_stop(state))
        if state.runtime_state == STOPPED:
            return self._stopped(ConditionKind.PROGRAM_REPLACED, state, "The robot program stopped")
        told = self._stop.told
        if told is not None and told.kind in ROBOT_STOPS and state.runtime_state not in (PLAYING, -1):
            if told.kind is ConditionKind.PROGRAM_PAUSED:
                return told
            return self._still_paused(told.kind, state)
        if state.runtime_state == PAUSED:
            return self._stopped(ConditionKind.PROGRAM_PAUSED, state, "The robot program was paused")
        return None

    def _still_paused(self, kind: ConditionKind, state: RobotState) -> Condition:
        is_safeguard = kind is ConditionKind.SAFEGUARD_STOP
        over = self._words.safeguard_closed if is_safeguard else f"The {kind.replace('_', ' ')} is cleared"
        advice = f"Resume the program at {self._words.panel}."
        return Condition(kind, state.capture_ns, f"{over}, but the program is still paused.", advice)

    def _stopped(self, kind: ConditionKind, state: RobotState, text: str) -> Condition:
        words = self._words
        advice = ADVICE[kind].format(panel=words.panel, close_safeguard=words.close_safeguard)
        cycle_index = self._first_cycle_index + state.cycle_count
        return Condition(kind, state.capture_ns, f"{text} in cycle {cycle_index}.", advice)

    def _judge_slider(self, state: RobotState) -> Condition | None:
        if not abs(state.speed_fraction - self._speed_fraction) > SLIDER_STEP:
            return None
        slider = self._words.slider
        text = f"The {slider} was moved from {self._speed_fraction:.0%} to {state.speed_fraction:.0%}."
        advice = f"Put the {slider} back to {self._speed_fraction:.0%}."
        return Condition(ConditionKind.SLIDER_MOVED, state.capture_ns, text, advice)


class LinkGuard:
    """Silence of the tracker, and a robot whose packages come late: by our own receive clock."""

    def __init__(self, policy: PolicyConfig, clock: Clock, notify: Notify) -> None:
        self._clock = clock
        self._silence_s = policy.tracker_silence_s
        self._residual_ms = policy.clock_residual_ms
        self._tracker = Switch(notify)
        self._residual = Switch(notify)
        self._frame_ns = 0
        self._window: tuple[int, int] | None = None

    def update_tracker(self, arrival_ns: int) -> None:
        self._frame_ns = arrival_ns

    def begin_again(self) -> None:
        """Count the tracker's silence from now: nobody listened before."""
        self._frame_ns = self._clock.now_ns()

    def update_lag(self, lag_ns: int, arrival_ns: int) -> None:
        """Take one package's lag behind the controller's own clock into account.

        At a scaled clock a lag is this machine's, which cannot keep up: the run warns of that at its end.
        """
        if self._clock.speed != 1.0:
            return
        began_ns, least_ns = self._window or (arrival_ns, lag_ns)
        least_ns = min(least_ns, lag_ns)
        if arrival_ns - began_ns < patience_ns(self._clock, LAG_WINDOW_S):
            self._window = (began_ns, least_ns)
            return
        self._window = None
        self._residual.set(self._judge_lag(least_ns, arrival_ns))

    def _judge_lag(self, least_ns: int, arrival_ns: int) -> Condition | None:
        if least_ns <= self._residual_ms * 1e6:
            return None
        text = f"The robot's packages come {least_ns * 1e-6:.0f} ms late, more than {self._residual_ms:g} ms."
        advice = "Look at the network and at what else this machine does; it goes on when they come in time."
        return Condition(ConditionKind.CLOCK_RESIDUAL, arrival_ns, text, advice, DeviceError)

    def poll(self) -> None:
        now_ns = self._clock.now_ns()
        if now_ns - self._frame_ns <= patience_ns(self._clock, self._silence_s):
            self._tracker.set(None)
            return
        text = f"The tracker has sent no frame for {self._silence_s:g} s."
        advice = "Check the tracker's streaming, its PC and the network cable; it goes on when frames come again."
        self._tracker.set(Condition(ConditionKind.TRACKER_SILENT, now_ns, text, advice, LinkLostError))


class DiskGuard:
    """Whether the rest of the run fits the disk."""

    def __init__(
        self,
        policy: PolicyConfig,
        clock: Clock,
        notify: Notify,
        free_bytes: Callable[[], int],
        written: Callable[[], int],
    ) -> None:
        self._reserve = policy.free_space_mb * 1e6
        self._clock = clock
        self._switch = Switch(notify)
        self._free_bytes = free_bytes
        self._written = written
        self._next_ns = 0
        self._n_begun: int | None = None
        self._first: tuple[int, int] | None = None

    def poll(self, n_completed: int, n_cycles: int) -> None:
        """Look at the disk, once a second."""
        now_ns = self._clock.now_ns()
        if now_ns < self._next_ns:
            return
        self._next_ns = now_ns + patience_ns(self._clock, DISK_PERIOD_S)
        needed, free = self._reserve + self._foretell(n_completed, n_cycles), self._free_bytes()
        if free >= needed:
            self._switch.set(None)
            return
        text = (
            f"The disk has {free / 1e6:.0f} MB free; {needed / 1e6:.0f} MB are needed for the other "
            f"{n_cycles - n_completed} cycles and a reserve of {self._reserve / 1e6:.0f} MB."
        )
        advice = "Free some space on the disk of the run file."
        self._switch.set(Condition(ConditionKind.DISK_LOW, now_ns, text, advice, DiskFullError))

    def _foretell(self, n_completed: int, n_cycles: int) -> float:
        written = self._written()
        if self._n_begun is None:
            self._n_begun = n_completed
        if self._first is None:
            if n_completed == self._n_begun:  # the first cycle may be slower than the others
                return 0.0
            self._first = (n_completed, written)
        n_before, written_before = self._first
        if n_completed - n_before < FORECAST_CYCLES:
            return 0.0
        return (written - written_before) / (n_completed - n_before) * (n_cycles - n_completed)


class Guards:
    """All guards of a run. While not armed they only remember what they need later.

    Parameters
    ----------
    policy : PolicyConfig
        Limits.
    clock : Clock
    notify : callable
        Told `ConditionRaised` and `ConditionCleared`, from the thread that feeds.
    record : callable
        Where it is logged that bench itself stood still.
    free_bytes, written : callable
        Free space on the run file's disk, and the size of the run file so far.
    first_cycle_index : int, optional
        Cycles completed before the robot's counter was 0.
    words : RobotWords, optional
        What the operator reads; left out, those of a UR.
    """

    def __init__(
        self,
        policy: PolicyConfig,
        clock: Clock,
        notify: Notify,
        record: Callable[[Record], None],
        free_bytes: Callable[[], int],
        written: Callable[[], int],
        first_cycle_index: int = 0,
        words: RobotWords = UR_WORDS,
    ) -> None:
        self._own_pause = OwnPause(clock, record)
        self._robot = RobotGuard(notify, first_cycle_index, words)
        self._links = LinkGuard(policy, clock, notify)
        self._disk = DiskGuard(policy, clock, notify, free_bytes, written)
        self._latest: RobotState | None = None
        self._armed = False

    def arm(self) -> None:
        """Begin to judge; the present slider is the one the run is made with."""
        self.expect_speed(float("nan") if self._latest is None else self._latest.speed_fraction)
        self._armed = True

    def expect_speed(self, fraction: float) -> None:
        """Take `fraction` as the speed slider's place from here on; NaN: any, while bench itself moves it."""
        self._robot.expect_speed(fraction)

    def disarm(self) -> None:
        """Stop judging: what comes from here on is not the run's."""
        self._armed = False

    def update_robot(self, state: RobotState, lag_ns: int) -> None:
        """Take one robot state, and its lag behind the controller's clock, into account."""
        self._latest = state
        if self._armed:
            self._robot.update(state)
            self._links.update_lag(lag_ns, state.arrival_ns)

    def update_tracker(self, arrival_ns: int) -> None:
        """Take the arrival of a frame into account."""
        self._links.update_tracker(arrival_ns)

    def poll(self, n_completed: int, n_cycles: int) -> None:
        """Judge what shows by its absence; from the engine's thread."""
        if self._armed:
            if self._own_pause.look():
                self._links.begin_again()
            self._links.poll()
            self._disk.poll(n_completed, n_cycles)
