"""The commands, and how their errors become exit codes."""

from __future__ import annotations

import sys
import traceback
from collections.abc import Callable
from typing import Annotated

import typer

from bench.cli.accuracy import accuracy
from bench.cli.calibrate import calibrate
from bench.cli.check import check
from bench.cli.compare import compare
from bench.cli.config import config_app
from bench.cli.examples import show_examples
from bench.cli.export import export
from bench.cli.import_ import import_
from bench.cli.info import info
from bench.cli.live import live
from bench.cli.report import report
from bench.cli.run import run
from bench.cli.salvage import salvage
from bench.cli.simulate import simulate
from bench.errors import BenchError

__all__ = ["app", "main"]

app = typer.Typer(
    name="bench",
    help="Measures how a moving cable bends: drives a robot's path, records an optical tracker, "
    "gives curvature and bend radius per cycle. Software is no safety function: use the emergency stop.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
)
COMMANDS: dict[str, Callable[..., None]] = {
    "run": run,
    "check": check,
    "report": report,
    "info": info,
    "calibrate": calibrate,
    "import": import_,
    "export": export,
    "salvage": salvage,
    "accuracy": accuracy,
    "compare": compare,
    "live": live,
    "simulate": simulate,
}
"""In the order of the help."""
for name, command in COMMANDS.items():
    app.command(name, epilog=show_examples(name))(command)
app.add_typer(config_app, name="config")


def _show_version(wanted: bool) -> None:
    if wanted:
        from importlib import metadata

        print(f"bench {metadata.version('cable-bench')}")
        raise typer.Exit


@app.callback()
def _options(
    debug: Annotated[bool, typer.Option("--debug", help="Show the traceback of an error.")] = False,
    version: Annotated[
        bool, typer.Option("--version", callback=_show_version, is_eager=True, help="Show the version and exit.")
    ] = False,
) -> None:
    """Take the options that stand before the command."""


def main() -> None:
    """Run the command line; a `BenchError` becomes one sentence on stderr and its exit code.

    Faults of the command line itself are the parser's: it says them, and exits with 2.
    """
    arguments = [argument for argument in sys.argv[1:] if argument != "--debug"]
    debug = len(arguments) < len(sys.argv) - 1
    try:
        app(arguments)
    except BenchError as error:
        _say(f"error: {error}", error if debug else None)
        sys.exit(error.exit_code)
    except Exception as error:  # what nobody foresaw is still one sentence, and says where the rest is
        _say(f"error: {type(error).__name__}: {error}", error if debug else None)
        _say("This is a fault of bench itself; run again with --debug for the details.")
        sys.exit(70)


def _say(text: str, error: Exception | None = None) -> None:
    if error is not None:
        traceback.print_exception(error)
    print(text, file=sys.stderr)
