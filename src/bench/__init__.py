"""The instrument that tells a cable lab how long a moving cable will live."""

from importlib.metadata import version

__all__ = ["__version__"]

__version__ = version("cable-bench")
