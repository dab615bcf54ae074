"""``bench check``."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from bench.cli.settings import ConfigArgument, config_or_simulated, program_or_none, settings_or_none, verify_run_name
from bench.errors import ConfigError

if TYPE_CHECKING:
    from bench.config import Config, ProgramFile
    from bench.model import CheckItem
    from bench.run import RunView

__all__ = ["check"]


def check(
    config: ConfigArgument = None,
    watch: Annotated[
        bool, typer.Option("--watch", help="Show every signal of the robot live instead, until Ctrl-C; write nothing.")
    ] = False,
    cycle: Annotated[
        bool,
        typer.Option("--cycle", help="THE ROBOT MOVES: drive one slow cycle, record it, and judge the optics by it."),
    ] = False,
    recording: Annotated[
        Path | None,
        typer.Option("--recording", metavar="RUN.mcap", help="Judge the optics by this run's first cycle instead."),
    ] = None,
    output: Annotated[
        Path | None, typer.Option("--output", help="With --cycle: its run file. Never overwritten.")
    ] = None,
    speed: Annotated[
        float, typer.Option("--speed", min=0.1, max=1000, help="With --cycle, simulated bench: times real time.")
    ] = 1.0,
) -> None:
    """Run the preflight alone: every item with limit, value and verdict. The robot moves with --cycle only."""
    _verify_options(watch=watch, cycle=cycle, recording=recording, output=output, speed=speed)
    from rich.console import Console

    from bench.run import RunView, watch_robot

    view = RunView(Console())
    if recording is not None:
        _judge_optics(recording, settings_or_none(config), view)
        return
    settings = config_or_simulated(config)
    program = program_or_none(settings, config)
    if watch:
        watch_robot(settings, Console())
    elif cycle:
        _judge_optics(_drive_slow_cycle(settings, program, output, speed, view), settings, view)
    else:
        from bench.run import check as check_bench

        _conclude(check_bench(settings, view, program=program), view)


def _verify_options(*, watch: bool, cycle: bool, recording: Path | None, output: Path | None, speed: float) -> None:
    if watch + cycle + (recording is not None) > 1:
        raise ConfigError("Of --watch, --cycle and --recording one can be given.")
    if not cycle and (output is not None or speed != 1.0):
        raise ConfigError("--output and --speed belong to --cycle.")
    verify_run_name(output)


def _drive_slow_cycle(
    settings: Config, program: ProgramFile | None, output: Path | None, speed: float, view: RunView
) -> Path:
    """Drive and record one cycle; return the run file."""
    from bench.run import RunOptions, make_slow_cycle
    from bench.run import run as run_bench

    slow = make_slow_cycle(settings)
    at = slow.run.first_cycle_speed
    how = f"with the speed slider at {at:.0%}" if at < 1 else "at its program's own speed: it has no slider to move"
    view.say(f"The robot will drive one cycle, {how}.")
    summary = run_bench(slow, RunOptions(n_cycles=1, output=output, speed=speed, program=program), view)
    for text in summary.warnings:
        print(f"warning: {text}")
    if summary.path is None or summary.n_completed < 1:
        print(f"The optics were not judged: {summary.ending.reason}.")
        raise typer.Exit(4)
    return summary.path


def _judge_optics(path: Path, settings: Config | None, view: RunView) -> None:
    from bench.recording import open_run
    from bench.report.optics_text import judge_optics

    run = open_run(path)
    findings = judge_optics(run, settings or run.config)
    print(f"The optics, by the first cycle in {path}:")
    _conclude(findings.items, view, findings.lines)


def _conclude(items: Sequence[CheckItem], view: RunView, lines: Sequence[str] = ()) -> None:
    from bench.run import verify_items

    for item in items:
        view.show_item(item)
    for line in lines:
        print(line)
    verify_items(items)
    verdicts = {item.verdict for item in items}
    print("Ready, with warnings." if "warn" in verdicts else "All checks passed.")
