"""What the operator sees while a run goes on: a live table in a terminal, plain lines elsewhere."""

from __future__ import annotations

import statistics
from collections.abc import Iterator
from contextlib import contextmanager

from rich.console import Console, Group, RenderableType
from rich.live import Live
from rich.markup import escape
from rich.progress_bar import ProgressBar
from rich.table import Table
from rich.text import Text

from bench.model import CheckItem
from bench.recording import RunWriter
from bench.run.bench_links import BenchLinks
from bench.run.progress import RunProgress
from bench.timing import RunClock, patience_ns

__all__ = ["RunView"]

REDRAW_S = 0.25
PLAIN_LINE_S = 10.0
"""Seconds of machine time between two lines where there is no terminal: a night gives 3 000 lines at most."""
MARKS = {"ok": "[green]ok[/]  ", "warn": "[yellow]warn[/]", "fail": "[red]fail[/]", "open": "[dim]open[/]"}
REMARKS = {"warn": "yellow", "open": "dim"}
"""Verdicts with a sentence on the screen; a failure's is in the error."""
RECENT_CYCLES = 20


class RunView:
    """The screen of a run."""

    def __init__(self, console: Console) -> None:
        self._console = console
        self._live: Live | None = None
        self._drawn_ns = 0
        self._cycle_said = -1
        self._note_said = ""

    def say(self, text: str) -> None:
        """Show one line of news."""
        self._console.print(text, style="dim", highlight=False, markup=False, soft_wrap=True)

    def show_item(self, item: CheckItem) -> None:
        """Show one preflight item with limit, value and verdict."""
        line = f"  {MARKS[item.verdict]} {escape(f'{item.name:<15} {item.value} (limit: {item.limit})')}"
        self._console.print(line, highlight=False, soft_wrap=True)
        if item.verdict in REMARKS:
            style = REMARKS[item.verdict]
            self._console.print(f"       {item.sentence}", style=style, highlight=False, markup=False, soft_wrap=True)

    @contextmanager
    def live(self) -> Iterator[None]:
        """Keep the live table on the screen while the run goes on."""
        if not self._console.is_terminal:
            yield
            return
        with Live(console=self._console, auto_refresh=False, transient=True) as self._live:
            yield
        self._live = None

    def update(self, progress: RunProgress, writer: RunWriter, links: BenchLinks, clock: RunClock) -> None:
        """Redraw, if it is time to."""
        pause_s = REDRAW_S if self._live else PLAIN_LINE_S
        now_ns = clock.now_ns()
        self._say_note(progress.note)
        due = now_ns - self._drawn_ns >= patience_ns(clock, pause_s)
        finished = progress.n_completed == progress.n_cycles and self._cycle_said != progress.n_completed
        if not due and not finished:
            return
        self._drawn_ns = now_ns
        self._cycle_said = progress.n_completed
        if self._live:
            self._live.update(_draw(progress, writer, links, clock), refresh=True)
        else:
            line = f"cycle {_cycle_line(progress)}; time left {_time_left(progress, clock)}; {_losses(writer)}"
            self._console.print(line, highlight=False, soft_wrap=True)

    def _say_note(self, note: str) -> None:
        """Print what the operator must do when it is news: in a terminal it stays above the live table as well."""
        if note and note != self._note_said:
            self._console.print(note, style="bold yellow", highlight=False, markup=False, soft_wrap=True)
        self._note_said = note


def _draw(progress: RunProgress, writer: RunWriter, links: BenchLinks, clock: RunClock) -> RenderableType:
    bar = ProgressBar(total=progress.n_cycles, completed=progress.n_completed, width=40)
    table = Table.grid(padding=(0, 2))
    table.add_row("cycle", _cycle_line(progress))
    table.add_row("", bar)
    table.add_row("time left", _time_left(progress, clock))
    table.add_row("robot", f"{links.robot_tally.device_rate_hz:.1f} Hz, {links.robot_tally.n_states} states")
    tally = links.frame_tally
    table.add_row("tracker", f"{tally.rate_hz:.1f} Hz, {tally.n_frames} frames, {tally.latest_points} points")
    table.add_row("recorded", f"{writer.bytes_written / 1e6:.1f} MB, queue {writer.queue_length}")
    table.add_row("losses", _losses(writer))
    note = progress.note or "Ctrl-C once: stop after this cycle. Twice: abort now."
    return Group(table, Text(note, style="bold yellow" if progress.note else "dim"))


def _cycle_line(progress: RunProgress) -> str:
    running = progress.cycle_started_ns >= 0
    current = min(progress.n_completed + 1, progress.n_cycles) if running else progress.n_completed
    state = "running" if running else "done"
    return f"{current} of {progress.n_cycles} {state}"


def _time_left(progress: RunProgress, clock: RunClock) -> str:
    usual_ns = progress.cycle_durations_ns[progress.n_slowed :]
    if not usual_ns:
        return f"known after the {'second' if progress.n_slowed else 'first'} cycle"
    recent = statistics.median(usual_ns[-RECENT_CYCLES:])
    seconds = (progress.n_cycles - progress.n_completed) * recent / patience_ns(clock, 1.0)
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours:d}:{minutes:02d}:{rest:02d}"


def _losses(writer: RunWriter) -> str:
    stats = writer.stats.values()
    dropped, missed = sum(s.dropped for s in stats), sum(s.missed for s in stats)
    return f"{dropped} dropped, {missed} missed"
