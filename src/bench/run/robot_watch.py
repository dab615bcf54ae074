"""A look at the robot's signals, live: ``bench check --watch``."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator

from rich.console import Console
from rich.live import Live
from rich.table import Table

from bench.config import Config
from bench.drivers.base import ShownSignal
from bench.drivers.robot import make_signal_watch
from bench.errors import ConfigError, DeviceError
from bench.run.closing import Closing
from bench.run.simulator import SimulatorProcess
from bench.timing import RunClock

__all__ = ["watch_robot"]

REDRAW_S = 0.2
LINE_S = 1.0
"""Where there is no terminal a line is written for each change, looked for once a second."""

Show = Callable[[list[ShownSignal], str], None]


def watch_robot(config: Config, console: Console) -> None:
    """Show every signal of the robot until Ctrl-C. Nothing is written to the controller.

    An answer that fails is shown, and the next one asked for: a controller may be restarted meanwhile.

    Raises
    ------
    ConfigError
        There is no robot.
    DeviceError
        It cannot be reached.
    """
    if config.robot is None:
        raise ConfigError("The configuration has no [robot] table, so there is nothing to watch.")
    clock = RunClock.start()
    with Closing() as closing, contextlib.suppress(KeyboardInterrupt):
        if config.simulation is not None:
            simulator = SimulatorProcess(config, clock)
            closing.add("the simulated bench", simulator.close, limit_s=120.0)
            for line in simulator.start():
                console.print(line, style="dim", highlight=False, markup=False, soft_wrap=True)
        watch = make_signal_watch(config.robot, clock)
        closing.add("the robot", watch.close)
        watch.open()
        with _screen(console) as (show, period_s):
            while True:
                shown, trouble = _look(watch.read)
                show(shown, trouble)
                clock.sleep_until_ns(clock.now_ns() + round(period_s * 1e9))


def _look(read: Callable[[], list[ShownSignal]]) -> tuple[list[ShownSignal], str]:
    try:
        return read(), ""
    except DeviceError as error:
        return [], str(error)


@contextlib.contextmanager
def _screen(console: Console) -> Iterator[tuple[Show, float]]:
    """Give the way to show signals, and how often: a table in a terminal, lines elsewhere."""
    if not console.is_terminal:
        yield _Lines(console).show, LINE_S
        return
    with Live(console=console, auto_refresh=False) as live:
        yield lambda shown, trouble: live.update(_make_table(shown, trouble), refresh=True), REDRAW_S


def _make_table(shown: list[ShownSignal], trouble: str) -> Table:
    table = Table(caption=trouble or "Ctrl-C ends it.", caption_style="red" if trouble else "dim")
    for heading in ("signal", "value", "place"):
        table.add_column(heading)
    for signal in shown:
        table.add_row(signal.name, signal.value, signal.place)
    return table


class _Lines:
    """Says each signal once, and again when it changes."""

    def __init__(self, console: Console) -> None:
        self._console = console
        self._said: dict[str, str] = {}

    def show(self, shown: list[ShownSignal], trouble: str) -> None:
        for signal in [*shown, *([ShownSignal("error", trouble)] if trouble else [])]:
            if self._said.get(signal.name) != signal.value:
                self._said[signal.name] = signal.value
                place = f"  [{signal.place}]" if signal.place else ""
                line = f"{signal.name} = {signal.value}{place}"
                self._console.print(line, highlight=False, markup=False, soft_wrap=True)
