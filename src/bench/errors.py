"""Every error bench raises, in one tree; each class carries its process exit code.

::

    BenchError                      .hint, .exit_code
      ConfigError            2      the configuration or the command line
      DeviceError            3      a robot or a tracker
        ConnectError                cannot be reached
        LinkLostError               was reached, went silent or closed
        DeviceTimeoutError          did not do in time what it was asked to do
        ProtocolError               sent bytes we cannot read
        DeviceStateError            is in a state that forbids what was asked
      RunError               4      the run as a whole
        PreflightError              one or more checks failed (all of them listed)
        IllegalTransitionError      a state change that the state table does not hold
        CycleTimeoutError           a cycle did not start or end in time
        CycleSequenceError          the robot's counter skipped or went back
      RecordingError         5      the run file
        RecordingExistsError        would overwrite
        QueueOverflowError          records arrived faster than the disk takes them
        DiskFullError               the disk cannot take the run
        RecordingUnfinishedError    cannot be read as a run file
      AnalysisError          6      the result
        TooFewMarkersError          no curve can be drawn through what was seen
"""

from __future__ import annotations

from collections.abc import Sequence

__all__ = [
    "AnalysisError",
    "BenchError",
    "ConfigError",
    "ConnectError",
    "CycleSequenceError",
    "CycleTimeoutError",
    "DeviceError",
    "DeviceStateError",
    "DeviceTimeoutError",
    "DiskFullError",
    "IllegalTransitionError",
    "LinkLostError",
    "PreflightError",
    "ProtocolError",
    "QueueOverflowError",
    "RecordingError",
    "RecordingExistsError",
    "RecordingUnfinishedError",
    "RunError",
    "TooFewMarkersError",
]


class BenchError(Exception):
    """Base of every error that bench raises on purpose.

    Parameters
    ----------
    message : str
        One plain sentence: what, which device or file, the limit and the value.
    hint : str, optional
        What the user does next.
    """

    exit_code = 1

    def __init__(self, message: str, *, hint: str = "") -> None:
        super().__init__(message)
        self.hint = hint

    def __str__(self) -> str:
        message = super().__str__()
        return f"{message} {self.hint}" if self.hint else message


class ConfigError(BenchError):
    exit_code = 2


class DeviceError(BenchError):
    exit_code = 3


class ConnectError(DeviceError):
    pass


class LinkLostError(DeviceError):
    pass


class DeviceTimeoutError(DeviceError):
    pass


class ProtocolError(DeviceError):
    pass


class DeviceStateError(DeviceError):
    pass


class RunError(BenchError):
    exit_code = 4


class PreflightError(RunError):
    """One or more preflight items failed.

    Parameters
    ----------
    failures : sequence of str
        One sentence for each failed item; all of them are reported at once.
    exit_code : int, optional
        The exit code of the gravest cause; a device that cannot be used is 3.
    """

    def __init__(self, failures: Sequence[str], *, exit_code: int | None = None, hint: str = "") -> None:
        between = "\n  - " if len(failures) > 1 else " "
        super().__init__(f"Preflight failed:{between}{between.join(failures)}", hint=hint)
        self.failures = tuple(failures)
        if exit_code is not None:
            self.exit_code = exit_code


class IllegalTransitionError(RunError):
    pass


class CycleTimeoutError(RunError):
    pass


class CycleSequenceError(RunError):
    pass


class RecordingError(BenchError):
    exit_code = 5


class RecordingExistsError(RecordingError):
    pass


class QueueOverflowError(RecordingError):
    pass


class DiskFullError(RecordingError):
    pass


class RecordingUnfinishedError(RecordingError):
    pass


class AnalysisError(BenchError):
    exit_code = 6


class TooFewMarkersError(AnalysisError):
    pass
