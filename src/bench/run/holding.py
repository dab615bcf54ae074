"""What the policies make of the conditions that are present."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Sequence

from bench.config import PolicyConfig
from bench.errors import BenchError
from bench.model import LogEntry, Record, Severity
from bench.run.conditions import Condition, ConditionKind
from bench.timing import Clock

__all__ = ["Holding"]


class Holding:
    """The conditions a run waits for.

    Parameters
    ----------
    policy : PolicyConfig
        What is done about each kind.
    clock : Clock
    record : callable
        Where every condition is logged.
    explain : callable
        Asks the robot why its program is not running; sentences.
    """

    def __init__(
        self,
        policy: PolicyConfig,
        clock: Clock,
        record: Callable[[Record], None],
        explain: Callable[[], Sequence[str]] = tuple,
    ) -> None:
        self._policy = policy
        self._clock = clock
        self._record = record
        self._explain = explain
        self._present: dict[ConditionKind, Condition] = {}
        self.stop_reason = ""
        """Why a policy ends the run after this cycle; empty if none does."""

    def add(self, condition: Condition) -> None:
        """Take a condition into account; raise it as an error where the policy is to abort."""
        action = self._find_action(condition.kind)
        self._log(condition.host_ns, Severity.WARN, f"{condition.text} {condition.advice} Policy: {action}.")
        if action == "abort":
            raise condition.to_error(self._ask_robot() if condition.stops_robot else "")
        if action == "stop":
            self.stop_reason = condition.text
        if action == "hold" or condition.holds_at_once:
            self._present[condition.kind] = condition

    def remove(self, kind: ConditionKind) -> None:
        """Forget a condition that is over."""
        if self._present.pop(kind, None) is not None:
            self._log(self._clock.now_ns(), Severity.INFO, f"Over: {kind.replace('_', ' ')}.")

    def stop_instead(self) -> bool:
        """Turn what is waited for into a stop, for a robot that waits for no grant; tell whether there was any."""
        if self._present and not self.stop_reason:
            self.stop_reason = f"{self.reason} Its program waits for no grant, so it cannot be held between cycles."
        return bool(self._present)

    @property
    def reason(self) -> str:
        """What is waited for; empty if nothing is."""
        return " ".join(condition.text for condition in self._present.values())

    @property
    def is_due_at_once(self) -> bool:
        """Whether the run must hold even inside a cycle."""
        return any(condition.holds_at_once for condition in self._present.values())

    @property
    def note(self) -> str:
        """What the operator should know and do now; empty if nothing."""
        return " ".join(f"{condition.text} {condition.advice}" for condition in self._present.values())

    def _find_action(self, kind: ConditionKind) -> str:
        return "hold" if kind is ConditionKind.PROGRAM_PAUSED else str(getattr(self._policy, kind.value))

    def _ask_robot(self) -> str:
        with contextlib.suppress(BenchError):  # what was seen already is reason enough
            return " ".join(self._explain())
        return ""

    def _log(self, host_ns: int, severity: Severity, text: str) -> None:
        self._record(LogEntry(host_ns, severity, "run", text))
