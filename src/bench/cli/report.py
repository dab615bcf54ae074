"""``bench report``."""

from __future__ import annotations

import sys
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from bench.cli.settings import settings_or_none, with_limits
from bench.cli.text_tables import verify_folder
from bench.errors import BenchError, ConfigError

if TYPE_CHECKING:
    from bench.config import Config
    from bench.report.results import Results

__all__ = ["name_without_suffix", "report"]

EXIT_CODES = {"PASS": 0, "FAIL": 1, "ERROR": 6}
"""By outcome. ERROR is the bench's fault: there is no verdict on the cable, so the analysis did not succeed."""


def report(
    runs: Annotated[list[Path], typer.Argument(metavar="RUN.mcap…", help="Run files, each analysed by itself.")],
    output: Annotated[
        Path | None,
        typer.Option(
            "--output",
            metavar="DIR",
            help="Folder for the results; several runs: DIR/NAME. Left out: RUN without .mcap.",
        ),
    ] = None,
    config: Annotated[
        Path | None,
        typer.Option(
            "--config",
            help="Take the analysis' settings, the cable's limits and the calibration (if it has one) from here, not "
            "from the recording.",
        ),
    ] = None,
    mcap: Annotated[
        bool, typer.Option("--mcap", help="Also write derived.mcap: sorted markers, line and curvature, for viewers.")
    ] = False,
) -> None:
    """Analyse run files: sorted markers, curvature and bend radius per cycle, tables and report.html.

    Exit code 0: outcome PASS. 1: FAIL, the cable was bent tighter than its limit. 6: ERROR, the bench was at fault and
    there is no verdict; also when the analysis itself cannot be done. A take without a robot passes when the limit
    holds. Of several runs the largest code counts. Results that exist are never overwritten (exit code 5).
    """
    settings = settings_or_none(config)
    runs = [run for run in runs if not _is_reported_with_another(run, runs)]
    folders = _output_folders(runs, output)
    for folder in folders:
        _verify_free(folder, mcap=mcap)
    if len(runs) == 1:
        raise typer.Exit(_report_one(runs[0], folders[0], settings, mcap=mcap))
    codes = [_report_or_say(run, folder, settings, mcap=mcap) for run, folder in zip(runs, folders, strict=True)]
    raise typer.Exit(max(codes))


def _is_reported_with_another(run: Path, runs: Sequence[Path]) -> bool:
    """Tell, also on the screen, that a file is a later part of a run whose first part is among `runs`."""
    from bench.recording import active_path, find_first, open_run

    first = find_first(run)
    given = [one for one in runs if first is not None and one in (first, active_path(first))]
    try:
        if not given or open_run(run).part_number == 1:
            return False
    except BenchError:
        return False
    print(f"{run} is a part of the run of {given[0]}, and in its report.")
    return True


def _output_folders(runs: Sequence[Path], output: Path | None) -> list[Path]:
    """Return one folder for each run; raise `ConfigError` when two runs would share one."""
    if output is None:
        folders = [run.parent / name_without_suffix(run) for run in runs]
    elif len(runs) == 1:
        folders = [output]
    else:
        folders = [output / name_without_suffix(run) for run in runs]
    shared = [folder for folder, count in Counter(folders).items() if count > 1]
    if shared:
        raise ConfigError(
            f"More than one run would be reported into {shared[0]}.", hint="Report them one by one, each with --output."
        )
    return folders


def name_without_suffix(run: Path) -> str:
    """Return the run's name without .mcap (or .mcap.active, when it was never finished)."""
    name = run.name.removesuffix(".active")
    stem = name.removesuffix(".mcap")
    return stem if stem and stem != run.name else f"{run.name}-report"


def _verify_free(folder: Path, *, mcap: bool) -> None:
    from bench.report.derived import DERIVED_NAME
    from bench.report.html import REPORT_NAME
    from bench.report.tables import TABLE_FILES

    verify_folder(folder, (REPORT_NAME, *TABLE_FILES, *([DERIVED_NAME] if mcap else [])))


def _report_or_say(run: Path, folder: Path, settings: Config | None, *, mcap: bool) -> int:
    """Report one of several runs: what is wrong with it must not keep the others from being reported."""
    print(f"{run}:", flush=True)
    try:
        return _report_one(run, folder, settings, mcap=mcap)
    except BenchError as error:
        print(f"error: {run}: {error}", file=sys.stderr)
        return error.exit_code


def _report_one(path: Path, folder: Path, settings: Config | None, *, mcap: bool) -> int:
    # The figures' and the tables' libraries take half a second to load, which `bench --help` does not spend.
    from bench.recording import open_run
    from bench.report.derived import write_derived
    from bench.report.html import write_report
    from bench.report.pipeline import analyse_run
    from bench.report.tables import write_tables

    run = open_run(path)
    settings_used = with_limits(run.config, settings, path) if settings else run.config
    results = analyse_run(run, settings_used, run_path=path.name)
    folder.mkdir(parents=True, exist_ok=True)
    write_tables(results, folder)
    if mcap:
        write_derived(results, folder)
    page = write_report(results, folder)
    _print_summary(results, page)
    return EXIT_CODES[results.outcome]


def _print_summary(results: Results, page: Path) -> None:
    from bench.report.cautions import list_cautions
    from bench.report.headline import summarise
    from bench.report.wording import describe_interval, describe_outcome, describe_place, describe_seen, say_radius

    headline = summarise(results)
    print(f"{results.outcome.value}: {' '.join(describe_outcome(results, headline))}")
    print(f"cycles: {headline.n_ok} of {headline.n_cycles} ok; {describe_seen(results) or 'no frames'}")
    bend = headline.tightest
    if bend is not None:
        measured = f"{say_radius(bend.radius_mm, bend.low_mm)} mm, {describe_interval(bend)}"
        print(f"smallest bend radius: {measured}; limit {headline.limit_mm:g} mm; {describe_place(bend)}")
    for sentence in list_cautions(results, headline):
        print(f"look at: {sentence}")
    n_frames = results.frames.frame_number.size
    if results.analysis_s > 0:
        print(
            f"analysis: {n_frames} frames in {results.analysis_s:.1f} s ({n_frames / results.analysis_s:.0f} frames/s)"
        )
    print(f"report: {page}")
