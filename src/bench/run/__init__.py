"""Drives the bench and records it: preflight, cycles, closing; and the import of takes into the same recording."""

from bench.run.live_process import LiveAddress
from bench.run.options import RunOptions, RunSummary
from bench.run.plan import describe_plan
from bench.run.preflight import verify_items
from bench.run.resume import Origin, read_origin, verify_origin
from bench.run.robot_watch import watch_robot
from bench.run.session import check, run
from bench.run.simulator import with_free_addresses
from bench.run.slow_cycle import make_slow_cycle
from bench.run.view import RunView

__all__ = [
    "LiveAddress",
    "Origin",
    "RunOptions",
    "RunSummary",
    "RunView",
    "check",
    "describe_plan",
    "make_slow_cycle",
    "read_origin",
    "run",
    "verify_items",
    "verify_origin",
    "watch_robot",
    "with_free_addresses",
]
