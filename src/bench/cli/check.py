"""``bench check``."""

from __future__ import annotations

from typing import Annotated

import typer

from bench.cli.run import ConfigArgument, config_or_simulated

__all__ = ["check"]


def check(
    config: ConfigArgument = None,
    watch: Annotated[
        bool, typer.Option("--watch", help="Show every signal of the robot live instead, until Ctrl-C; write nothing.")
    ] = False,
) -> None:
    """Run the preflight alone: every item with limit, value and verdict. The robot does not move."""
    settings = config_or_simulated(config)
    from rich.console import Console

    from bench.run import RunView, verify_items, watch_robot
    from bench.run import check as check_bench

    if watch:
        watch_robot(settings, Console())
        return
    view = RunView(Console())
    items = check_bench(settings, view)
    for item in items:
        view.show_item(item)
    verify_items(items)
    print("All checks passed." if all(item.verdict != "warn" for item in items) else "Ready, with warnings.")
