"""``bench accuracy``."""

from __future__ import annotations

from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from bench.cli.report import name_without_suffix
from bench.cli.settings import settings_or_none, with_limits
from bench.cli.shapes import AMmOption, RadiusMmOption, ShapeKind, ShapeOption, choose_shape
from bench.cli.text_tables import show_tables, verify_folder
from bench.errors import ConfigError

if TYPE_CHECKING:
    from bench.report.accuracy import Subject

__all__ = ["accuracy"]

ROD_STIFFNESS_NM2 = (0.1, 0.02, 0.005, 0.002)
"""From a stiff hose to a limp cable."""
ROD_LENGTH_M = 1.5
ROD_WEIGHT_N_PER_M = 1.5
ROD_SPAN_M = (0.7, 0.1)
"""Across and up from one clamp to the other."""
ROD_TURN_RAD = 0.2
"""Both clamps point down by this much."""
ROD_SEGMENTS = 900
"""The peak curvature of the limpest is then solved to 0.1 %."""
ROD_MARKERS = 10


def accuracy(
    run: Annotated[
        Path | None,
        typer.Argument(metavar="[RUN.mcap]", help="A recording of a known shape; left out: the study."),
    ] = None,
    shape: ShapeOption = None,
    radius_mm: RadiusMmOption = None,
    a_mm: AMmOption = None,
    output: Annotated[
        Path | None,
        typer.Option("--output", metavar="DIR", help="Folder for the results; left out: accuracy, or RUN-accuracy."),
    ] = None,
    config: Annotated[
        Path | None, typer.Option("--config", help="With RUN: take the analysis' settings from here.")
    ] = None,
) -> None:
    """Say how accurate the bend radius is: every estimator on shapes whose radius is known.

    Without RUN the paper's error study, by calculation: circle and catenary, ideal and tracked, and clamped cables.
    With RUN and --shape the same for a recording of a template. Exit code 5: results exist, or the file cannot be
    read. 6: the markers do not lie on the shape.
    """
    if run is None:
        _verify_study_options(shape, radius_mm, a_mm, config)
        _study(output or Path("accuracy"))
    elif shape is None:
        raise ConfigError(
            "A recording needs --shape: what was recorded.", hint="For example: --shape circle --radius-mm 400."
        )
    else:
        folder = output or run.parent / f"{name_without_suffix(run)}-accuracy"
        _measure(run, folder, config, shape, radius_mm, a_mm)


def _verify_study_options(
    shape: ShapeKind | None, radius_mm: float | None, a_mm: float | None, config: Path | None
) -> None:
    given = {"--shape": shape, "--radius-mm": radius_mm, "--a-mm": a_mm, "--config": config}
    needless = [name for name, value in given.items() if value is not None]
    if needless:
        raise ConfigError(f"{needless[0]} needs RUN.mcap, a recording of a known shape.")


def _study(folder: Path) -> None:
    import numpy as np

    from bench.analysis import ESTIMATORS
    from bench.config import AnalysisConfig
    from bench.report.accuracy import (
        ACCURACY_FILES,
        ACCURACY_PAGE,
        explain_skipped,
        make_paper_subjects,
        run_study,
        tabulate_study,
        write_study_page,
        write_study_tables,
    )

    verify_folder(folder, (ACCURACY_PAGE, *ACCURACY_FILES))
    rods = [_hang_rod(stiffness) for stiffness in ROD_STIFFNESS_NM2]
    noise_m = AnalysisConfig().marker_noise_mm * 1e-3
    study = run_study([*make_paper_subjects(), *rods], ESTIMATORS, noise_m)
    versions = {"bench": version("cable-bench"), "numpy": np.__version__}
    write_study_tables(study, versions, folder)
    page = write_study_page(study, versions, folder)
    show_tables(tabulate_study(study))
    for sentence in explain_skipped(study):
        print(f"not tried: {sentence}")
    print(f"page: {page}")


def _hang_rod(stiffness_nm2: float) -> Subject:
    """Return a clamped cable with weight and bending stiffness: the simulated bench's model, on a fine grid."""
    import numpy as np

    from bench.analysis import SampledShape
    from bench.report.accuracy import make_rod_subject
    from bench.simulation.elastica import Clamps, Elastica

    rod = Elastica(ROD_LENGTH_M, ROD_WEIGHT_N_PER_M, stiffness_nm2, ROD_SEGMENTS)
    hung = rod.hang(Clamps(*ROD_SPAN_M, -ROD_TURN_RAD, ROD_TURN_RAD))
    angle = hung.angle_rad
    step = rod.segment_m * np.stack([np.cos(angle), np.sin(angle), np.zeros_like(angle)], axis=1)
    at_nodes = np.concatenate([[-ROD_TURN_RAD], (angle[1:] + angle[:-1]) / 2, [ROD_TURN_RAD]])
    shape = SampledShape(
        name=f"EI {stiffness_nm2:g} N m²",
        arc_length_m=np.linspace(0.0, ROD_LENGTH_M, ROD_SEGMENTS + 1),
        angle_rad=at_nodes,
        position_m=np.concatenate([np.zeros((1, 3)), np.cumsum(step, axis=0)]),
        curvature_per_m=np.abs(rod.curvature(hung)),
    )
    return make_rod_subject(stiffness_nm2, shape, ROD_MARKERS)


def _measure(
    path: Path, folder: Path, config: Path | None, kind: ShapeKind, radius_mm: float | None, a_mm: float | None
) -> None:
    from bench.analysis import ESTIMATORS
    from bench.recording import open_run
    from bench.report.accuracy import (
        ACCURACY_FILES,
        ACCURACY_PAGE,
        describe_template,
        explain_unmeasured,
        judge_noise,
        measure_template,
        tabulate_template,
        write_template_page,
        write_template_tables,
    )
    from bench.report.pipeline import analyse_run

    chosen = choose_shape(kind, radius_mm, a_mm)
    settings = settings_or_none(config)
    verify_folder(folder, (ACCURACY_PAGE, *ACCURACY_FILES))
    run = open_run(path)
    results = analyse_run(run, with_limits(run.config, settings, path) if settings else run.config, run_path=path.name)
    template = measure_template(results, chosen.shape, chosen.make, chosen.size_m, ESTIMATORS)
    write_template_tables(template, folder)
    page = write_template_page(template, folder)
    for name, text in describe_template(template).items():
        print(f"{name + ':':<26}{text}")
    show_tables(tabulate_template(template))
    for sentence in filter(None, [judge_noise(template), *explain_unmeasured(template)]):
        print(f"note: {sentence}")
    print(f"page: {page}")
