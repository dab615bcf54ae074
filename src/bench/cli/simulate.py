"""``bench simulate``: the only door to the simulated bench."""

from __future__ import annotations

import gc
import os
import signal
import sys
import threading
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from bench.simulation.bench import SimulatedBench
    from bench.timing import RunClock

__all__ = ["serve_bench", "simulate"]

WORTH_SAYING_S = 0.25
"""Machine time by which simulated devices may lag before it is said: `bench run` has the same limit."""


def simulate(
    config: Annotated[
        Path | None, typer.Argument(metavar="[CONFIG]", help="Configuration file. Left out: the packaged one.")
    ] = None,
    truth: Annotated[
        Path | None, typer.Option("--truth", help="Write what the simulated tracker knew, as Parquet.")
    ] = None,
    speed: Annotated[float, typer.Option("--speed", min=0.1, max=1000, help="Times real time.")] = 1.0,
    clock: Annotated[str, typer.Option("--clock", hidden=True)] = "",
    until_stdin_closes: Annotated[bool, typer.Option("--until-stdin-closes", hidden=True)] = False,
) -> None:
    """Serve the simulated robot and tracker alone, for trying any client against them. Ctrl-C ends it."""
    from bench.timing import RunClock

    run_clock = RunClock.from_text(clock) if clock else RunClock.start(speed)
    serve_bench(config, run_clock, truth=truth, until_stdin_closes=until_stdin_closes)


def serve_bench(
    config_path: Path | None, clock: RunClock, *, truth: Path | None = None, until_stdin_closes: bool = False
) -> None:
    """Run the simulated bench until SIGINT or SIGTERM comes or, if asked, standard input closes.

    Prints one line on standard output for each device that serves. Ends orderly in all these cases: ports closed,
    truth file complete.

    Raises
    ------
    ConfigError, ConnectError, RecordingError
        The configuration cannot be simulated, a port is in use, the truth file cannot be written.
    """
    from bench.config import load_config, simulated_config
    from bench.simulation.bench import SimulatedBench

    config = load_config(config_path) if config_path is not None else simulated_config()
    bench = SimulatedBench(config, clock, truth=truth)
    _stop_on_signals(bench)
    lines = bench.open()
    try:
        print("\n".join(lines), flush=True)
        if until_stdin_closes:
            threading.Thread(target=_stop_at_end_of_input, args=(bench,), name="stdin", daemon=True).start()
        gc.freeze()  # measured: a full collection holds up ticks for 35 ms without it
        bench.run()
    finally:
        bench.close()
    _say_lag(bench.scheduler.largest_lag_ns, clock)


def _stop_on_signals(bench: SimulatedBench) -> None:
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: bench.stop())


def _stop_at_end_of_input(bench: SimulatedBench) -> None:
    # The parent holds the other end open as long as it lives; a killed parent closes it too.
    while os.read(sys.stdin.fileno(), 4096):
        pass
    bench.stop()


def _say_lag(lag_ns: int, clock: RunClock) -> None:
    from bench.timing import patience_ns

    if lag_ns > patience_ns(clock, WORTH_SAYING_S):
        machine_s = lag_ns / clock.speed * 1e-9
        print(f"This machine was up to {machine_s:.2f} s too slow for --speed {clock.speed:g}.", file=sys.stderr)
