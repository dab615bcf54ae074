"""What stands below the options of ``bench COMMAND --help``: calls to copy and change."""

from __future__ import annotations

__all__ = ["EXAMPLES", "show_examples"]

EXAMPLES = {
    "run": (
        "bench run --cycles 5 --speed 5",
        "bench run lab.toml --cycles 100000 --dry-run",
        "bench run lab.toml --cycles 100000 --resume RUN.mcap",
    ),
    "check": ("bench check lab.toml", "bench check lab.toml --cycle", "bench check lab.toml --recording RUN.mcap"),
    "report": ("bench report RUN.mcap", "bench report RUN.mcap --config other-limits.toml --output again"),
    "info": ("bench info RUN.mcap", "bench info runs/*.mcap"),
    "calibrate": ("bench calibrate RUN.mcap --output calibration.toml",),
    "import": ("bench import take.csv --config take.toml --output take.mcap",),
    "export": ("bench export RUN.mcap --format c3d", "bench export RUN.mcap --format parquet --topic all"),
    "salvage": ("bench salvage RUN.mcap.active --in-place", "bench salvage RUN.mcap --output GOOD.mcap"),
    "accuracy": ("bench accuracy", "bench accuracy RUN.mcap --shape circle --radius-mm 400"),
    "compare": (
        "bench compare first.mcap later.mcap",
        "bench compare RUN.mcap simulation.mcap --align space --align time",
        "bench compare RUN.mcap --shape catenary --a-mm 500",
    ),
    "live": ("bench live RUN.mcap.active",),
    "simulate": ("bench simulate --speed 5",),
}
"""By command; RUN.mcap stands for the file of a run."""


def show_examples(command: str) -> str:
    """Return the examples of a command for its help: one line each (the help joins the lines of a paragraph)."""
    return "\n\n".join(["Examples:", *EXAMPLES[command]])
