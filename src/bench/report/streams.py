"""What became of every topic: received, written, dropped, missed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import numpy.typing as npt

from bench.recording import BODIES, FRAME, POINTS, ROBOT, Run
from bench.report.results import StreamFinding

__all__ = ["find_missing", "find_streams"]

DEVICE_TOPICS = (ROBOT, POINTS, FRAME, BODIES)


def find_streams(run: Run, gaps: Mapping[str, int]) -> list[StreamFinding]:
    """Return one finding for each topic that anything is known of, the devices' first.

    The recorder's totals stand at the end of a finished file; in an unfinished one its last statistics are used. A
    count of what never came is also made from the recorded sequence itself, and the larger of the two is reported.

    Parameters
    ----------
    run : Run
        The run file.
    gaps : mapping
        Records missing in the recorded sequence, by topic; those that the recorder dropped are among them.
    """
    topics = sorted({*run.topics, *run.totals}, key=lambda name: (name not in DEVICE_TOPICS, name))
    findings = [_find_stream(run, topic, gaps.get(topic, 0)) for topic in topics]
    return [one for one in findings if one.received or one.written or one.missed]


def find_missing(streams: Sequence[StreamFinding]) -> dict[str, StreamFinding]:
    """Return for each device the stream of which most never came; devices of which nothing is missing are left out.

    The topics of one device are filled from the same records (a frame and its points come in one packet), so what is
    missing counts once and not once for each topic.
    """
    worst: dict[str, StreamFinding] = {}
    for stream in streams:
        device = stream.topic.strip("/").split("/")[0]
        if stream.missed > (worst[device].missed if device in worst else 0):
            worst[device] = stream
    return worst


def _find_stream(run: Run, topic: str, n_gaps: int) -> StreamFinding:
    n_read, total = run.topics.get(topic, 0), run.totals.get(topic)
    dropped, missed = (total.dropped, total.missed) if total else (0, 0)
    finished = bool(run.metadata.get("bench.end"))
    written = total.written if total and finished else n_read
    return StreamFinding(
        topic=topic,
        rate_hz=_rate(run[topic].log_time_ns) if topic in DEVICE_TOPICS else float("nan"),
        received=written + dropped,
        written=written,
        dropped=dropped,
        missed=max(missed, n_gaps - dropped),
    )


def _rate(times: npt.NDArray[np.int64]) -> float:
    span = (int(times.max()) - int(times.min())) * 1e-9 if len(times) > 1 else 0.0
    return (len(times) - 1) / span if span > 0 else float("nan")
