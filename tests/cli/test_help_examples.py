"""What ``bench COMMAND --help`` shows to copy is understood by the command, and ``--version`` says one line."""

from importlib import metadata

import pytest
import typer
from typer.testing import CliRunner

from bench.cli.app import app
from bench.cli.examples import EXAMPLES

COMMANDS = typer.main.get_command(app).commands  # type: ignore[attr-defined]


def test_every_command_has_examples() -> None:
    assert set(EXAMPLES) == set(COMMANDS) - {"config"}


@pytest.mark.parametrize("line", [line for lines in EXAMPLES.values() for line in lines])
def test_an_example_is_understood_by_its_command(line: str) -> None:
    bench, name, *arguments = line.split()
    assert bench == "bench"
    assert COMMANDS[name].make_context(name, arguments).params


@pytest.mark.parametrize("name", EXAMPLES)
def test_help_shows_the_examples(name: str) -> None:
    shown = " ".join(CliRunner().invoke(app, [name, "--help"]).output.split())
    assert all(line in shown for line in EXAMPLES[name])


def test_the_version_is_one_line() -> None:
    shown = CliRunner().invoke(app, ["--version"])
    assert shown.output == f"bench {metadata.version('cable-bench')}\n"
    assert shown.exit_code == 0
