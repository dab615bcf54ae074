"""What a run calls things on the robot it drives, so that the operator reads the words of that controller."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

from bench.config import AnyRobotConfig
from bench.model import NO_BITS, RobotState
from bench.run.cycle_watcher import safety_text

__all__ = ["UR_WORDS", "RobotWords", "make_robot_words"]

SAFEGUARD = 5
"""As a UR says it (see `RobotState.safety_status`)."""


@dataclass(frozen=True, slots=True)
class RobotWords:
    """Words for one kind of controller."""

    panel: str
    """Where a person clears, resumes and looks."""
    slider: str
    """What sets the speed by hand."""
    close_safeguard: str
    """What a person does about a safeguard stop."""
    safeguard_closed: str
    """That it is done."""
    rate_key: str
    """The configuration's key for how often it is heard."""
    describe_stop: Callable[[RobotState], str]
    """What its safety status means, as the beginning of a sentence that ends in 'in cycle N'."""


def _describe_ur_stop(state: RobotState) -> str:
    text = safety_text(state.safety_status)
    return text[:1].upper() + text[1:]


UR_WORDS = RobotWords(
    panel="the pendant",
    slider="speed slider",
    close_safeguard="Close the safeguard",
    safeguard_closed="The safeguard stop is cleared",
    rate_key="rate_hz",
    describe_stop=_describe_ur_stop,
)


def make_robot_words(config: AnyRobotConfig) -> RobotWords:
    """Return the words for the configured robot."""
    if config.kind == "ur":
        return UR_WORDS
    return RobotWords(
        panel="the controller",
        slider="speed override",
        close_safeguard="Put it in order",
        safeguard_closed="The interlocks are in order again",
        rate_key="poll_rate_hz",
        describe_stop=partial(_describe_plc_stop, [interlock.name for interlock in config.map.interlock]),
    )


def _describe_plc_stop(interlocks: list[str], state: RobotState) -> str:
    if state.safety_status != SAFEGUARD or state.digital_inputs == NO_BITS:
        return "A fault of the controller"
    names = [f"'{name}'" for bit, name in enumerate(interlocks) if not state.digital_inputs >> bit & 1]
    return f"The interlock{'s' * (len(names) > 1)} {' and '.join(names)} opened"
