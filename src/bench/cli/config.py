"""``bench config schema|show|check``."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import typer

from bench.cli.settings import ConfigArgument, program_or_none

__all__ = ["config_app"]

config_app = typer.Typer(help="Schema, resolved values and validation of configuration files.", no_args_is_help=True)


@config_app.command("schema")
def schema() -> None:
    """Print the JSON schema of a configuration file."""
    from bench.config import config_schema

    print(json.dumps(config_schema(), indent=2, ensure_ascii=False))


@config_app.command("show")
def show(config: ConfigArgument = None) -> None:
    """Print the resolved configuration, every default included."""
    from bench.config import load_config, simulated_config, to_toml

    print(to_toml(load_config(config) if config else simulated_config()), end="")


@config_app.command("check")
def check(config: Annotated[Path, typer.Argument(metavar="CONFIG", help="Configuration file.")]) -> None:
    """Validate a configuration file; every fault with its line, and exit code 2."""
    from bench.config import load_config

    program_or_none(load_config(config), config)
    print(f"{config}: valid.")
