"""Child processes of a run: our own interpreter with another command, ended by the end of its input.

A child reads its standard input and ends when that closes: a parent that is killed leaves no orphan.
"""

from __future__ import annotations

import contextlib
import selectors
import subprocess
import time

__all__ = ["end_child", "read_ready_lines"]


def read_ready_lines(process: subprocess.Popen[bytes], n_lines: int, within_s: float) -> list[str]:
    """Return the lines ``ready …`` of a child's standard output: `n_lines`, or fewer if it ends or takes too long."""
    if process.stdout is None:
        return []
    received, deadline = b"", time.monotonic() + within_s
    with selectors.DefaultSelector() as selector:
        selector.register(process.stdout, selectors.EVENT_READ)
        while received.count(b"\n") < n_lines and (left := deadline - time.monotonic()) > 0:
            if selector.select(left):
                piece = process.stdout.read1(4096)  # type: ignore[attr-defined]  # a BufferedReader
                if not piece:
                    break
                received += piece
    return [line for line in received.decode("utf-8", "replace").splitlines() if line.startswith("ready ")]


def end_child(process: subprocess.Popen[bytes], within_s: float) -> int:
    """Close a child's input, kill it if it does not end by that, and return its exit code."""
    with contextlib.suppress(BrokenPipeError):
        if process.stdin is not None:
            process.stdin.close()
    try:
        process.wait(within_s)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()
    if process.stdout is not None:
        process.stdout.close()
    return process.returncode
