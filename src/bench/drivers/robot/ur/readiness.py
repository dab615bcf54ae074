"""Why a UR controller cannot run a program now, in sentences: the same whichever way it was asked."""

from __future__ import annotations

__all__ = ["mode_reason", "running_reason", "safety_reason"]


def safety_reason(peer: str, what: str, status: str) -> str:
    """Return what speaks against a safety status or mode (`what` it is called there); empty if nothing does."""
    if status == "NORMAL":
        return ""
    return (
        f"The safety {what} of {peer} is {status}, not NORMAL. "
        "Look at the robot and clear the stop on the teach pendant; bench never does that by itself."
    )


def mode_reason(peer: str, mode: str) -> str:
    """Return what speaks against a robot mode; empty if nothing does."""
    if mode == "RUNNING":
        return ""
    return (
        f"The robot mode of {peer} is {mode}, not RUNNING. "
        "Power the robot on and release its brakes on the teach pendant."
    )


def running_reason(peer: str, state: str, name: str, *, is_ours: bool) -> str:
    """Return what speaks against a program that is there already; empty if it is stopped.

    Parameters
    ----------
    peer, state : str
        The controller, and what its program is doing.
    name : str
        The program's; empty where the controller does not tell.
    is_ours : bool
        Whether it is the one to be run.
    """
    if state == "STOPPED":
        return ""
    what = f"'{name}'" if is_ours else f"'{name}', another program," if name else "a program"
    return f"On {peer} {what} is {state.lower()} already. Stop it on the teach pendant first."
