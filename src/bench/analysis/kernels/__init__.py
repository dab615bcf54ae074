"""Loops compiled to machine code. Imported where they are used, not with the package: numba takes 0.3 s to import."""
