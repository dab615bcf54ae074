"""One execution of ``bench run`` or ``bench check``, from the first connection to the last rename."""

from __future__ import annotations

import shlex
import uuid
from datetime import UTC, datetime
from pathlib import Path

from bench.config import Config, ProgramFile, to_toml
from bench.errors import ConfigError
from bench.model import CheckItem, ExitStatus, LogEntry, Record, RunState, Severity, StateChange
from bench.recording import RunWriter, active_path
from bench.run.about import attach_calibration, attach_program, describe_cycle_source, describe_origin, find_versions
from bench.run.bench_links import BenchLinks, require_devices
from bench.run.closing import Closing
from bench.run.engine import RunEngine
from bench.run.first_cycle import FirstCycle
from bench.run.holding import Holding
from bench.run.inbox import Fault, Inbox, QueueInbox
from bench.run.interrupts import ctrl_c_to
from bench.run.journal import Journal
from bench.run.live_process import LiveAddress, LiveProcess
from bench.run.loaded_program import ask_loaded
from bench.run.options import RunOptions, RunSummary
from bench.run.preflight import check_bench, show_program_file, verify_items
from bench.run.progress import Ending, RunLimits, RunProgress
from bench.run.resume import PROGRAM, RESUMED, hash_test, verify_origin
from bench.run.simulator import SimulatorProcess
from bench.run.states import RunStates
from bench.run.view import RunView
from bench.timing import RunClock, patience_ns

__all__ = ["check", "run"]

SETTLE_S = 1.0
"""Machine time the links stream before they are judged: 125 robot states and 100 frames at the slowest usual rates."""
CLOSE_FILE_S = 120.0
"""Machine time to drain the queue and finish the file on a slow disk."""
LIBRARIES = ("cable-bench", "numpy", "mcap", "ur-rtde", "httpx", "pymodbus")


def run(config: Config, options: RunOptions, view: RunView) -> RunSummary:
    """Preflight, drive, record, stop.

    Parameters
    ----------
    config : Config
        With a `[simulation]` table the simulated bench is started first, as a process of its own.
    options : RunOptions
    view : RunView
        Where the operator looks.

    Returns
    -------
    RunSummary
        Also when the operator ended the run early; its `ending` says so.

    Raises
    ------
    BenchError
        What ended the run; the run file is finished and readable all the same.
    """
    clock = _start_clock(config, options.speed)
    if options.origin is not None:
        verify_origin(options.origin, config, options.n_cycles, options.program)
    path = options.output or _default_path(config, clock)
    with Closing() as closing:
        if options.live is not None:
            _start_live(path, options.live, closing, view)
        session = _Session(config, options, path, clock, view, closing)
        session.run()
    return session.summarise()


def check(config: Config, view: RunView, speed: float = 1.0, program: ProgramFile | None = None) -> list[CheckItem]:
    """Run the preflight alone; nothing is recorded and the robot does not move.

    Raises
    ------
    DeviceError, PreflightError
        A device cannot be reached.
    """
    clock = _start_clock(config, speed)
    inbox = QueueInbox(clock)
    states = RunStates(clock, _discard)
    with Closing() as closing:
        states.enter(RunState.CONNECTING)
        _start_simulator(config, clock, None, closing, view)
        links = BenchLinks(config, clock, inbox, _discard, packets=_default_path(config, clock).with_suffix(""))
        links.open(closing)
        states.enter(RunState.CHECKING)
        items = [*_check(config, links, clock, Path(config.run.output_dir), None), *show_program_file(program)]
        states.enter(RunState.CLOSING)
    states.enter(RunState.DONE)
    return items


class _Session:
    """The steps of one run between opening and closing its file."""

    def __init__(
        self, config: Config, options: RunOptions, path: Path, clock: RunClock, view: RunView, closing: Closing
    ) -> None:
        self._config = config
        self._options = options
        self._path = path
        self._clock = clock
        self._view = view
        self._closing = closing
        self._inbox = QueueInbox(clock)
        run_id = str(uuid.uuid4())
        self._writer = _open_writer(config, path, clock, self._inbox, run_id, options)
        self._journal = Journal(
            path,
            {
                "run_id": run_id,
                "test_sha256": hash_test(config),
                "file": path.name,
                "cycles": options.n_cycles,
                "completed": options.n_before,
            },
        )
        closing.add("the run file", self._close_writer, limit_s=CLOSE_FILE_S)
        self._states = RunStates(clock, self._record_state)
        self._simulator: SimulatorProcess | None = None
        self._progress = RunProgress(options.n_cycles, options.n_before)
        self._ending = Ending(ExitStatus.FAIL, "ended without a reason")
        self._warnings: list[str] = []
        self._n_told = 0

    def run(self) -> None:
        """Connect, check, drive; whatever happens, the ending is known afterwards."""
        try:
            links = self._connect()
            self._preflight(links)
            self._ending = self._drive(links)
            self._warn_of_lag(links)
        except KeyboardInterrupt:
            self._ending = Ending(ExitStatus.ABORT, "stopped by the operator before the first cycle")
            self._states.abort(self._ending.reason)
        except BaseException as error:
            self._ending = Ending(ExitStatus.FAIL, str(error) or type(error).__name__)
            self._states.abort(self._ending.reason)
            raise
        finally:
            self._states.enter(RunState.CLOSING)

    def _record_state(self, record: Record) -> None:
        self._writer.put(record)
        if isinstance(record, StateChange):
            self._journal.note_state(record)

    def _refresh(self, links: BenchLinks) -> None:
        if self._simulator is not None:
            self._simulator.verify_alive()
        self._journal.note_completed(self._progress.n_completed)
        for text in self._writer.warnings[self._n_told :]:
            self._view.say(text)
            self._n_told += 1
        self._view.update(self._progress, self._writer, links, self._clock)

    def _close_writer(self) -> None:
        try:
            self._states.enter(RunState.DONE)
            self._finish_file()
        except BaseException:
            self._journal.close(remove=False)
            active = active_path(self._path)
            self._say_how_to_go_on(active if active.exists() else self._path)  # it may have gone on in another part
            raise
        self._journal.close(remove=True)
        self._say_how_to_go_on(self._path)

    def _finish_file(self) -> None:
        if self._progress.run_started_ns < 0:
            self._writer.discard()  # nothing was driven: the same command must work again once the cause is mended
            return
        self._writer.add_metadata("bench.cycles", {"completed": str(self._progress.n_completed)})
        self._writer.close(exit_status=str(self._ending.status), reason=self._ending.reason)

    def _say_how_to_go_on(self, path: Path) -> None:
        progress = self._progress
        if progress.run_started_ns < 0 or progress.n_completed >= progress.n_cycles or not path.exists():
            return
        speed = [] if self._options.speed == 1.0 else ["--speed", f"{self._options.speed:g}"]
        command = ["bench", "run", "--cycles", str(progress.n_cycles), *speed, "--resume", str(path)]
        self._view.say(f"To go on: {shlex.join(command)}")

    def _connect(self) -> BenchLinks:
        self._states.enter(RunState.CONNECTING)
        origin = self._options.origin
        if origin is not None:
            self._say(Severity.INFO, origin.describe())
            self._say(Severity.WARN, origin.doubt_program(self._options.program))
        self._simulator = _start_simulator(self._config, self._clock, self._options.truth, self._closing, self._view)
        writer = self._writer
        links = BenchLinks(
            self._config,
            self._clock,
            self._inbox,
            writer.put,
            writer.note_missed,
            free_bytes=lambda: writer.free_bytes,
            written=lambda: writer.bytes_written,
            first_cycle_index=self._options.n_before,
            packets=self._path.with_suffix(""),
        )
        for info in links.open(self._closing):
            writer.add_device(info)
            self._view.say(f"connected: {info.device} {info.kind} {info.address} {info.version}".rstrip())
            if info.device == "robot":
                writer.add_metadata("bench.cycle_source", describe_cycle_source(self._config, info.rate_hz))
        return links

    def _say(self, severity: Severity, text: str) -> None:
        if text:
            self._view.say(text)
            self._writer.put(LogEntry(self._clock.now_ns(), severity, "run", text))

    def _preflight(self, links: BenchLinks) -> None:
        self._states.enter(RunState.CHECKING)
        simulated = self._config.simulation
        n_left = self._options.n_cycles - self._options.n_before + 1.0 / self._config.run.first_cycle_speed - 1.0
        expected_s = n_left * simulated.cycle_s * 1.2 if simulated else None
        items = _check(self._config, links, self._clock, self._path.parent, expected_s)
        items += show_program_file(self._options.program)
        self._writer.add_metadata("bench.preflight", {item.name: f"{item.verdict}: {item.value}" for item in items})
        for item in items:
            self._view.show_item(item)
            if item.verdict in ("warn", "fail"):
                severity = Severity.WARN if item.verdict == "warn" else Severity.ERROR
                self._writer.put(LogEntry(self._clock.now_ns(), severity, "run", item.sentence))
        verify_items(items)
        told, doubts = ask_loaded(links.program, self._options.program, self._options.origin)
        self._writer.add_metadata(PROGRAM, told)
        for text in doubts:
            self._say(Severity.WARN, text)

    def _drive(self, links: BenchLinks) -> Ending:
        self._states.enter(RunState.ARMED)
        robot, _ = require_devices(self._config)
        engine = RunEngine(
            links.program,
            links.stream,
            links.watcher,
            links.guards,
            Holding(self._config.policy, self._clock, self._writer.put, lambda: links.program.check(robot.program)),
            self._inbox,
            self._states,
            self._clock,
            self._writer.put,
            self._progress,
            RunLimits(cycle_s=robot.cycle.timeout_s, hold_s=self._config.policy.hold_timeout_s),
            FirstCycle(links.slider, self._config.run.first_cycle_speed, lambda: links.watcher.speed_fraction),
            refresh=lambda: self._refresh(links),
            is_granted=robot.cycle.is_granted,
        )
        with ctrl_c_to(self._inbox), self._view.live():
            return engine.run()

    def _warn_of_lag(self, links: BenchLinks) -> None:
        if not links.pace.is_behind:
            return
        lag_s = links.pace.largest_lag_ns / patience_ns(self._clock, 1.0)
        scaled = self._clock.speed != 1.0
        cause = f"This machine cannot keep up with --speed {self._clock.speed:g}: the" if scaled else "The"
        advice = "use a lower --speed" if scaled else "look at the network and at what else this machine does"
        text = (
            f"{cause} robot's stream arrived up to {lag_s:.1f} s late. No cycle and no record is lost by that, "
            f"but arrival times are worth less; {advice}."
        )
        self._writer.put(LogEntry(self._clock.now_ns(), Severity.WARN, "run", text))
        self._warnings.append(text)

    def summarise(self) -> RunSummary:
        """Say how the run ended; after closing."""
        started = self._progress.run_started_ns
        durations_ns = self._progress.cycle_durations_ns
        return RunSummary(
            self._path if started >= 0 else None,
            self._ending,
            self._progress.n_completed,
            self._progress.n_cycles,
            self._writer.stats,
            self._writer.bytes_written,
            sum(durations_ns) * 1e-9,
            [*self._warnings, *self._writer.warnings, *self._progress.warnings, *self._closing.notes],
            len(self._writer.paths),
        )


def _start_clock(config: Config, speed: float) -> RunClock:
    if speed != 1.0 and config.simulation is None:
        raise ConfigError(
            f"--speed {speed:g} was given, but a real bench runs in real time.",
            hint="Leave --speed out, or use a configuration with a [simulation] table.",
        )
    return RunClock.start(speed)


def _start_live(path: Path, address: LiveAddress, closing: Closing, view: RunView) -> None:
    """Start the live view before the run file is there, so that it is closed after it."""
    process = LiveProcess(path, address)
    closing.add("the live view", process.close, limit_s=60.0)
    view.say(process.start())


def _start_simulator(
    config: Config, clock: RunClock, truth: Path | None, closing: Closing, view: RunView
) -> SimulatorProcess | None:
    if config.simulation is None:
        if truth is not None:
            raise ConfigError("--truth was given, but only the simulated bench knows the truth.")
        return None
    simulator = SimulatorProcess(config, clock, truth)
    closing.add("the simulated bench", simulator.close, limit_s=120.0)
    for line in simulator.start():
        view.say(line)
    return simulator


def _check(
    config: Config, links: BenchLinks, clock: RunClock, folder: Path, expected_s: float | None
) -> list[CheckItem]:
    clock.sleep_until_ns(clock.now_ns() + patience_ns(clock, SETTLE_S))
    return check_bench(
        config,
        links.program,
        links.watcher,
        links.robot_tally,
        links.frame_tally,
        folder,
        expected_s,
        clock.speed,
        has_slider=links.slider is not None,
    )


def _open_writer(
    config: Config, path: Path, clock: RunClock, inbox: Inbox, run_id: str, options: RunOptions
) -> RunWriter:
    origin, program = options.origin, options.program
    facts = {"clock": clock.to_text(), "simulated": str(config.simulation is not None).lower()}
    extra = {"bench.facts": describe_origin(config) | facts}
    extra |= {RESUMED: origin.to_metadata()} if origin else {}
    extra |= {PROGRAM: program.to_metadata()} if program else {}
    return RunWriter(
        path,
        clock,
        config_toml=to_toml(config),
        versions=find_versions(LIBRARIES),
        run_id=run_id,
        extra=extra,
        attachments={**attach_calibration(config), **attach_program(program)},
        on_failure=lambda error: inbox.put(Fault(error)),
        split_bytes=config.run.split_bytes,
    )


def _default_path(config: Config, clock: RunClock) -> Path:
    moment = datetime.fromtimestamp(clock.utc_ns * 1e-9, UTC)
    return Path(config.run.output_dir) / f"{config.run.name}-{moment:%Y%m%dT%H%M%SZ}.mcap"


def _discard(_record: Record) -> None:
    """Take a record nobody wants: a check alone records nothing."""
