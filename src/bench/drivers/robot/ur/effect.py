"""Waiting until what a controller was asked to do is seen: it replies before it acts."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from bench.errors import DeviceTimeoutError
from bench.timing import Clock, patience_ns

__all__ = ["USUAL_LIMITS", "EffectLimits", "wait_for_effect"]

POLL_S = 0.05


@dataclass(frozen=True, slots=True)
class EffectLimits:
    """How long an effect may take, in the machine's own seconds."""

    command_s: float = 10.0
    """A program starts and stops within a second; a slow controller is given ten times that."""
    load_s: float = 60.0
    """Loading a program may load its installation too, which takes up to half a minute."""


USUAL_LIMITS = EffectLimits()


def wait_for_effect(clock: Clock, peer: str, command: str, is_reached: Callable[[], bool], limit_s: float) -> None:
    """Poll until `is_reached`, for at most `limit_s` of the machine's own seconds.

    Raises
    ------
    DeviceTimeoutError
        The effect was not seen; the sentence names `peer` and `command`.
    """
    limit_ns = clock.now_ns() + patience_ns(clock, limit_s)
    while not is_reached():
        if clock.now_ns() > limit_ns:
            raise DeviceTimeoutError(
                f"The {peer} accepted to {command} but has not done so after {limit_s:g} s.",
                hint="Look at the teach pendant: a question or a message may be waiting there.",
            )
        clock.sleep_until_ns(clock.now_ns() + patience_ns(clock, POLL_S))
