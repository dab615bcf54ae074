"""``bench calibrate``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from bench.cli.settings import settings_or_none
from bench.errors import RecordingError, RecordingExistsError

if TYPE_CHECKING:
    from bench.report.calibration import CalibrationResults

__all__ = ["calibrate"]


def calibrate(
    run: Annotated[Path, typer.Argument(metavar="RUN.mcap", help="A run in which the flange's body was tracked.")],
    output: Annotated[Path, typer.Option("--output", help="The calibration file.")] = Path("calibration.toml"),
    flange_body: Annotated[
        str, typer.Option("--flange-body", help="Rigid body on the flange; left out: the configuration's flange_body.")
    ] = "",
    config: Annotated[
        Path | None, typer.Option("--config", help="Take the configuration from here, not from the recording.")
    ] = None,
    force: Annotated[bool, typer.Option("--force", help="Replace the file if it exists.")] = False,
) -> None:
    """Find robot and tracker in one space and one time, and measure the markers' places.

    Writes a calibration file for a configuration to name. Exit code 5: the file exists, and --force is not given. 6:
    the run does not tell what is wanted.
    """
    if output.exists() and not force:
        raise RecordingExistsError(
            f"{output} exists already and is not overwritten.", hint="Choose another --output, or give --force."
        )
    from bench.recording import open_run
    from bench.report.calibration import calibrate_run, describe_calibration

    recorded = open_run(run)
    settings = settings_or_none(config) or recorded.config
    found = calibrate_run(recorded, settings, flange_body)
    for line in describe_calibration(found):
        print(line)
    _write(found, output, force)
    print(f'{output}: name it in a configuration as [calibration] file = "{output.name}".')


def _write(found: CalibrationResults, path: Path, force: bool) -> None:
    from bench.config import to_toml

    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with path.open("w" if force else "x", encoding="utf-8") as file:
            file.write(to_toml(found.calibration))
    except FileExistsError as error:
        raise RecordingExistsError(f"{path} appeared while it was written.", hint="Give another name.") from error
    except OSError as error:
        raise RecordingError(f"The calibration cannot be written to {path}: {error.strerror or error}.") from error
