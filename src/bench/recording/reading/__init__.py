"""A run file as numpy columns."""
