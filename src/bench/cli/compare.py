"""``bench compare``."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from bench.cli.report import name_without_suffix
from bench.cli.settings import settings_or_none, with_limits
from bench.cli.shapes import AMmOption, ChosenShape, RadiusMmOption, ShapeKind, ShapeOption, choose_shape
from bench.cli.text_tables import verify_folder
from bench.errors import ConfigError

if TYPE_CHECKING:
    from bench.config import Config
    from bench.report.comparison import Comparison
    from bench.report.results import Results

__all__ = ["Alignment", "compare"]


class Alignment(StrEnum):
    """What is taken out before two motions are compared."""

    TIME = "time"
    SPACE = "space"


def compare(
    first: Annotated[Path, typer.Argument(metavar="A.mcap", help="A recording, of a run or of an import.")],
    second: Annotated[
        Path | None, typer.Argument(metavar="[B.mcap]", help="Another one; left out: the shape of --shape.")
    ] = None,
    align: Annotated[
        list[Alignment] | None,
        typer.Option("--align", help="Shift B to where it fits best: in time, in space; may be given twice."),
    ] = None,
    shape: ShapeOption = None,
    radius_mm: RadiusMmOption = None,
    a_mm: AMmOption = None,
    output: Annotated[
        Path | None, typer.Option("--output", metavar="DIR", help="Folder for the results; left out: A-against-B.")
    ] = None,
    config: Annotated[
        Path | None, typer.Option("--config", help="Take the analysis' settings from here, for both.")
    ] = None,
) -> None:
    """Say how far two motions of a cable are apart: eq. (6) of the paper, at equal phases of the cycle.

    Exit code 5: results exist, or a file cannot be read. 6: the two have no stretch of cable or no phase in common.
    """
    against = _choose_second(second, shape, radius_mm, a_mm, align)
    settings = settings_or_none(config)
    name = name_without_suffix(against) if isinstance(against, Path) else str(against.kind)
    folder = output or first.parent / f"{name_without_suffix(first)}-against-{name}"
    from bench.report.comparison import COMPARISON_FILES, describe_comparison, write_comparison

    verify_folder(folder, COMPARISON_FILES)
    found = _compare(_analyse(first, settings), against, set(align or ()), settings)
    page = write_comparison(found, folder)
    for label, text in describe_comparison(found).items():
        print(f"{label + ':':<20}{text}")
    for sentence in found.notes:
        print(f"note: {sentence}")
    print(f"page: {page}")


def _choose_second(
    second: Path | None,
    shape: ShapeKind | None,
    radius_mm: float | None,
    a_mm: float | None,
    align: list[Alignment] | None,
) -> Path | ChosenShape:
    if second is not None and shape is None:
        given = [name for name, size in (("--radius-mm", radius_mm), ("--a-mm", a_mm)) if size is not None]
        if given:
            raise ConfigError(f"{given[0]} belongs to --shape, not to B.mcap.")
        return second
    if second is not None or shape is None:
        raise ConfigError("Give either B.mcap or --shape: what A.mcap is compared with.")
    if align:
        raise ConfigError("--align belongs to B.mcap: a known shape is laid where it fits best anyway.")
    return choose_shape(shape, radius_mm, a_mm)


def _analyse(path: Path, settings: Config | None) -> Results:
    from bench.recording import open_run
    from bench.report.pipeline import analyse_run

    run = open_run(path)
    return analyse_run(run, with_limits(run.config, settings, path) if settings else run.config, run_path=path.name)


def _compare(first: Results, against: Path | ChosenShape, align: set[Alignment], settings: Config | None) -> Comparison:
    from bench.report.comparison import compare_runs, compare_with_shape

    if isinstance(against, ChosenShape):
        return compare_with_shape(first, against.shape)
    second = _analyse(against, settings)
    return compare_runs(first, second, in_time=Alignment.TIME in align, in_space=Alignment.SPACE in align)
