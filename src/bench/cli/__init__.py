"""The command ``bench``: parse, load the configuration, call one function, map its error to an exit code."""

__all__ = ["main"]


def main() -> None:
    """Run the command line."""
    from bench.cli.app import main as run_app

    run_app()
