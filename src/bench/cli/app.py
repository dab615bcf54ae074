"""The commands, and how their errors become exit codes."""

from __future__ import annotations

import sys
import traceback

import click
import typer

from bench.cli.check import check
from bench.cli.config import config_app
from bench.cli.import_ import import_
from bench.cli.report import report
from bench.cli.run import run
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
app.command("run")(run)
app.command("check")(check)
app.command("report")(report)
app.command("import")(import_)
app.command("simulate")(simulate)
app.add_typer(config_app, name="config")


@app.callback()
def _options(
    debug: bool = typer.Option(False, "--debug", help="Show the traceback of an error."),
) -> None:
    """Take the options that stand before the command."""


def main() -> None:
    """Run the command line; a `BenchError` becomes one sentence on stderr and its exit code."""
    debug = "--debug" in sys.argv[1:]
    try:
        code = app(standalone_mode=False)
    except BenchError as error:
        _say(error, debug)
        code = error.exit_code
    except click.exceptions.Abort:
        _say(KeyboardInterrupt("Interrupted."), debug)
        code = 4
    except click.ClickException as error:
        error.show()
        code = 2
    except Exception as error:  # what nobody foresaw: still one sentence, and where the rest is
        _say(error, debug)
        print("This is a fault of bench itself; run again with `bench --debug …` for the details.", file=sys.stderr)
        code = 70
    sys.exit(code if isinstance(code, int) else 0)


def _say(error: BaseException, debug: bool) -> None:
    if debug:
        traceback.print_exception(error)
    text = str(error) or type(error).__name__
    print(
        f"error: {text}" if isinstance(error, BenchError) else f"error: {type(error).__name__}: {text}", file=sys.stderr
    )
