"""One slow cycle to look at: the run that `bench check --cycle` drives."""

from __future__ import annotations

from bench.config import Config, RobotConfig

__all__ = ["SLOW_CYCLE_SPEED", "make_slow_cycle"]

SLOW_CYCLE_SPEED = 0.25
"""Slow enough to watch, and to know each marker from one frame to the next at a quarter of the usual frame rate."""
SUFFIX = "-check"
LONGEST_NAME = 80


def make_slow_cycle(config: Config) -> Config:
    """Return a configuration whose first cycle is driven slowly, where the robot can; its files are named so.

    A `[run] first_cycle_speed` that is given counts. Else it is 25 % for a UR whose program waits for grants, and the
    program's own speed for any other robot: those have no slider that can be moved from here.
    """
    robot = config.robot
    has_slider = isinstance(robot, RobotConfig) and robot.cycle.is_granted
    speed = config.run.first_cycle_speed
    name = config.run.name[: LONGEST_NAME - len(SUFFIX)] + SUFFIX
    slow = SLOW_CYCLE_SPEED if has_slider and speed == 1.0 else speed
    return config.model_copy(update={"run": config.run.model_copy(update={"first_cycle_speed": slow, "name": name})})
