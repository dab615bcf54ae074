"""``bench run``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from bench.cli.settings import ConfigArgument, config_or_simulated, program_or_none, verify_run_name

if TYPE_CHECKING:
    from bench.run import RunSummary

__all__ = ["run"]


def run(
    cycles: Annotated[int, typer.Option("--cycles", min=1, help="How many cycles to run.")],
    config: ConfigArgument = None,
    output: Annotated[
        Path | None, typer.Option("--output", help="Run file; left out: OUTPUT_DIR/NAME-TIME.mcap. Never overwritten.")
    ] = None,
    speed: Annotated[float, typer.Option("--speed", min=0.1, max=1000, help="Simulated bench: times real time.")] = 1.0,
    truth: Annotated[
        Path | None, typer.Option("--truth", help="Simulated bench: what the simulated tracker knew, as Parquet.")
    ] = None,
    resume: Annotated[
        Path | None,
        typer.Option(
            "--resume", help="Go on with the interrupted run of this file, in a new one; --cycles is the total."
        ),
    ] = None,
    live: Annotated[
        bool, typer.Option("--live", help="Serve the run to Lichtblick or Foxglove, from a process of its own.")
    ] = False,
    live_host: Annotated[
        str, typer.Option("--live-host", help="Address of the live view; others than loopback are open to all.")
    ] = "127.0.0.1",
    live_port: Annotated[
        int, typer.Option("--live-port", min=0, max=65535, help="TCP port of the live view; 0 is any free one.")
    ] = 8765,
    dry_run: Annotated[bool, typer.Option("--dry-run", help="Say what would happen; touch nothing.")] = False,
) -> None:
    """Preflight, drive N cycles, record, stop. Ctrl-C once: stop after this cycle. Twice: abort now."""
    verify_run_name(output)
    from bench.run import read_origin, verify_origin

    origin = read_origin(resume) if resume else None
    settings = origin.config if origin and config is None else config_or_simulated(config)
    from rich.console import Console

    from bench.run import LiveAddress, RunOptions, RunView, describe_plan
    from bench.run import run as run_bench

    address = LiveAddress(live_host, live_port) if live else None
    program = origin.read_program() if origin and not config else program_or_none(settings, config)
    options = RunOptions(
        n_cycles=cycles, output=output, speed=speed, truth=truth, origin=origin, program=program, live=address
    )
    if dry_run:
        if origin is not None:
            verify_origin(origin, settings, cycles, program)
        told = filter(None, [origin.describe(), origin.doubt_program(program)]) if origin else ()
        for line in [*told, *describe_plan(settings, options)]:
            print(line)
        return
    summary = run_bench(settings, options, RunView(Console()))
    _print_summary(summary)
    if summary.n_completed < summary.n_cycles:
        raise typer.Exit(4)


def _print_summary(summary: RunSummary) -> None:
    reason = summary.ending.reason
    print(f"{reason[:1].upper()}{reason[1:]}.")
    for text in summary.warnings:
        print(f"warning: {text}")
    if summary.path is None:
        print("Nothing was driven, so no run file was kept.")
        return
    received = {topic: stats.received for topic, stats in summary.stats.items()}
    dropped = sum(stats.dropped for stats in summary.stats.values())
    missed = sum(stats.missed for stats in summary.stats.values())
    size = f"{summary.bytes_written / 1e6:.1f} MB" + (f" in {summary.n_parts} parts" if summary.n_parts > 1 else "")
    print(
        f"{summary.path}: {size}, {received.get('/robot/state', 0)} robot states, "
        f"{received.get('/tracker/points', 0)} tracker frames, {dropped} dropped, {missed} missed."
    )
    print(f"Next: bench report {summary.path}")
