"""Closes what was opened, in reverse order, each step under a time limit, never hiding the first error."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable

__all__ = ["Closing"]

log = logging.getLogger(__name__)


class Closing:
    """The steps that end a run; used as a context manager, so that they always run.

    An error inside the block passes on unchanged. Without one, the first error of a closing step is raised after
    the last step.
    """

    def __init__(self) -> None:
        self._steps: list[tuple[str, Callable[[], object], float]] = []
        self.notes: list[str] = []
        """One sentence for each step that failed or ran out of time."""

    def add(self, what: str, step: Callable[[], object], limit_s: float = 10.0) -> None:
        """Remember a step: `what` completes the sentence "Closing … failed"."""
        self._steps.append((what, step, limit_s))

    def __enter__(self) -> Closing:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: object) -> None:
        first = self.run()
        if error is None and first is not None:
            raise first

    def run(self) -> Exception | None:
        """Run all steps that are left; return the first error."""
        first: Exception | None = None
        while self._steps:
            what, step, limit_s = self._steps.pop()
            error = _run_limited(step, limit_s)
            if error is not None:
                self.notes.append(f"Closing {what} failed: {error}")
                log.warning("closing %s failed: %s", what, error)
                first = first or error
        return first


def _run_limited(step: Callable[[], object], limit_s: float) -> Exception | None:
    """Run one step in a thread of its own, so that a device that hangs cannot keep the rest open."""
    outcome: list[Exception | None] = []

    def guarded() -> None:
        try:
            step()
            outcome.append(None)
        except Exception as error:  # whatever it is, the other steps must still run
            outcome.append(error)

    worker = threading.Thread(target=guarded, name="bench-closing", daemon=True)
    worker.start()
    worker.join(limit_s)
    return outcome[0] if outcome else TimeoutError(f"not done within {limit_s:g} s")
