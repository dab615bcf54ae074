"""The checks before a run: every item with its limit, its value and its verdict; all failures at once."""

from __future__ import annotations

import math
import shutil
from collections.abc import Callable, Sequence
from pathlib import Path

from bench.analysis import judge_frame_rate
from bench.config import LARGEST_PROGRAM, Config, ProgramFile, describe_program_file
from bench.drivers.base import ProgramControl
from bench.errors import BenchError, PreflightError
from bench.model import CheckItem
from bench.run.cycle_watcher import CycleWatcher
from bench.run.robot_words import UR_WORDS, RobotWords, make_robot_words
from bench.run.tally import FrameTally, RobotTally

__all__ = ["check_bench", "predict_bytes_per_s", "show_program_file", "verify_items"]

SMALLEST_RATE_RATIO = 0.95
"""A stream slower than this is not the stream that was asked for; jitter over one second is far smaller."""
ROBOT_BYTES = 460
"""One robot state in the run file before compression, see `bench.recording`."""
FRAME_BYTES = 330
POINT_BYTES = 24
COMPRESSED = 0.93
"""LZ4 on real-like data, measured 2026-11, see docs/explanations/recording.md."""
SAFETY_FACTOR = 2.0
"""Free space asked for, over what the run is predicted to take."""


def check_bench(
    config: Config,
    program: ProgramControl,
    watcher: CycleWatcher,
    robot: RobotTally,
    tracker: FrameTally,
    folder: Path,
    expected_s: float | None,
    speed: float = 1.0,
    *,
    has_slider: bool = True,
) -> list[CheckItem]:
    """Check everything a run depends on. The links are open and have streamed for a moment.

    Parameters
    ----------
    expected_s : float or None
        How long the run will take, where that is known; decides how much disk space is asked for.
    speed : float
        Of the run's clock: above 1 it is the machine that a slow stream speaks of.
    has_slider : bool
        Whether the robot has a speed slider that can be moved from here.
    """
    words = UR_WORDS if config.robot is None else make_robot_words(config.robot)
    return [
        *_check_program(config, program),
        _check_robot_rate(config, robot, words),
        _check_slider(config.run.first_cycle_speed, watcher.speed_fraction, has_slider, words),
        _check_tracker_rate(tracker, speed),
        _check_frame_rate(config, tracker),
        _check_markers(config, tracker),
        _check_disk(config, tracker, folder, expected_s),
    ]


def verify_items(items: Sequence[CheckItem]) -> None:
    """Raise `PreflightError` with every failed item, and the exit code of the first."""
    failed = [item for item in items if item.verdict == "fail"]
    if failed:
        raise PreflightError([item.sentence for item in failed], exit_code=failed[0].exit_code)


def show_program_file(program: ProgramFile | None) -> list[CheckItem]:
    """Return the item that shows which copy of the program travels in the run file, if one does; it was read before."""
    if program is None:
        return []
    limit = f"at most {LARGEST_PROGRAM / 1e6:g} MB"
    return [CheckItem("program file", limit, describe_program_file(program.to_metadata()), "ok")]


def predict_bytes_per_s(config: Config, tracker_rate_hz: float, n_points: float) -> float:
    """Return the size of one second of recording, in bytes."""
    robot = config.robot.rate_hz * ROBOT_BYTES if config.robot else 0.0
    return COMPRESSED * (robot + tracker_rate_hz * (FRAME_BYTES + n_points * POINT_BYTES))


def _check_program(config: Config, program: ProgramControl) -> list[CheckItem]:
    name = config.robot.program if config.robot else ""
    reasons = program.check(name)
    items = [CheckItem("robot ready", program.ready_when, "no", "fail", reason) for reason in reasons]
    if items:
        return items
    loaded = _attempt(lambda: program.load(name))
    verdict = "fail" if loaded else "ok"
    return [
        CheckItem("robot ready", program.ready_when, "yes", "ok"),
        CheckItem("program loaded", name, "no" if loaded else name, verdict, loaded),
    ]


def _attempt(action: Callable[[], None]) -> str:
    try:
        action()
    except BenchError as error:
        return str(error)
    return ""


def _check_robot_rate(config: Config, robot: RobotTally, words: RobotWords) -> CheckItem:
    wanted = config.robot.rate_hz if config.robot else 0.0
    rate = robot.device_rate_hz
    ok = rate >= SMALLEST_RATE_RATIO * wanted
    sentence = (
        f"The robot gives {rate:.1f} states/s instead of {wanted:g}: set [robot] {words.rate_key} to what it can give."
    )
    return CheckItem("robot rate", f">= {SMALLEST_RATE_RATIO * wanted:g} Hz", f"{rate:.1f} Hz", _verdict(ok), sentence)


def _check_slider(first_cycle_speed: float, fraction: float, has_slider: bool, words: RobotWords) -> CheckItem:
    value = "unknown" if math.isnan(fraction) else f"{fraction:.0%}"
    if first_cycle_speed < 1.0 and (not has_slider or math.isnan(fraction)):
        sentence = (
            f"[run] first_cycle_speed = {first_cycle_speed:g} needs a robot with a speed slider that bench can move "
            "and see; this one has none such: leave the key out."
        )
        return CheckItem(
            words.slider, "can be moved and seen", value if has_slider else "cannot be moved", "fail", sentence
        )
    ok = not fraction < 1.0
    sentence = f"The {words.slider} is at {fraction:.0%}: cycles take longer than the program's own time."
    return CheckItem(words.slider, "100 %", value, "ok" if ok else "warn", "" if ok else sentence)


def _check_tracker_rate(tracker: FrameTally, speed: float) -> CheckItem:
    rate, wanted = tracker.rate_hz, tracker.nominal_rate_hz
    limit = SMALLEST_RATE_RATIO * wanted if wanted == wanted else 0.0
    ok = tracker.n_frames > 1 and rate >= limit
    if tracker.n_frames <= 1:
        sentence = "The tracker answers but streams no frames: is Motive in live mode, with streaming enabled?"
    elif speed != 1.0:
        sentence = f"This machine cannot keep up with --speed {speed:g}: {rate:.1f} of {wanted:g} frames/s; use less."
    else:
        sentence = f"The tracker streams {rate:.1f} of {wanted:g} frames/s: check its network and its camera rate."
    return CheckItem("tracker rate", f">= {limit:g} Hz", f"{rate:.1f} Hz", _verdict(ok), sentence)


def _check_frame_rate(config: Config, tracker: FrameTally) -> CheckItem:
    nominal = tracker.nominal_rate_hz
    rate = tracker.rate_hz if math.isnan(nominal) else nominal
    accuracy_mm = config.tracker.accuracy_mm if config.tracker else math.nan
    return judge_frame_rate(rate, config.cable.max_speed_m_s, accuracy_mm, "as configured")


def _check_markers(config: Config, tracker: FrameTally) -> CheckItem:
    expected = len(config.cable.arc_length_m) + (config.cable.anchor.kind == "static_marker")
    seen = tracker.most_unlabeled
    limit = f"{expected} unlabeled"
    if seen == 0:
        sentence = "The tracker sees no markers: check exposure, threshold, and that unlabeled markers stream."
        return CheckItem("markers", limit, "0", "fail", sentence, exit_code=4)
    sentence = f"The tracker sees {seen} unlabeled markers, {expected} are configured: some are hidden at rest."
    enough = seen >= expected
    return CheckItem("markers", limit, str(seen), "ok" if enough else "warn", "" if enough else sentence)


def _check_disk(config: Config, tracker: FrameTally, folder: Path, expected_s: float | None) -> CheckItem:
    free = shutil.disk_usage(_existing(folder)).free
    per_s = predict_bytes_per_s(config, tracker.rate_hz, tracker.most_points)
    needed = SAFETY_FACTOR * per_s * (expected_s if expected_s is not None else 3600.0)
    what = "this run" if expected_s is not None else "one hour"
    sentence = f"{folder} has {_say_size(free)} free, {_say_size(needed)} are asked for ({what}, twice its size)."
    limit = f">= {_say_size(needed)} for {what}"
    return CheckItem("disk space", limit, _say_size(free), _verdict(free >= needed), sentence, exit_code=5)


def _say_size(n_bytes: float) -> str:
    return f"{n_bytes / 1e9:.0f} GB" if n_bytes >= 1e10 else f"{n_bytes / 1e6:.0f} MB"


def _existing(folder: Path) -> Path:
    while not folder.exists() and folder != folder.parent:
        folder = folder.parent
    return folder


def _verdict(ok: bool) -> str:
    return "ok" if ok else "fail"
