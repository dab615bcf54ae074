"""From a connected RTDE link to a started stream: version, recipes, START."""

from __future__ import annotations

from dataclasses import dataclass

from bench.config import RobotConfig
from bench.drivers.robot.ur.codec import (
    IN_USE,
    NOT_FOUND,
    PackageType,
    decode_accepted,
    decode_controller_version,
    decode_setup_reply,
    encode_input_setup,
    encode_output_setup,
    encode_protocol_version,
)
from bench.drivers.robot.ur.fields import essential_outputs, wanted_outputs
from bench.drivers.robot.ur.link import RtdeLink
from bench.drivers.robot.ur.recipe import Recipe
from bench.drivers.robot.ur.versions import Version, too_new_outputs
from bench.errors import DeviceStateError, ProtocolError

__all__ = ["Session", "delivered_rate_hz", "start_session"]

CB3_MAJOR = 3
CB3_RATE_HZ = 125.0
E_SERIES_RATE_HZ = 500.0
GRANT_TYPE = "INT32"


@dataclass(frozen=True, slots=True)
class Session:
    """What was agreed with the controller."""

    version: Version
    rate_hz: float
    """Rate that was asked for: the controller's own, or a whole fraction of it."""
    outputs: Recipe
    inputs: Recipe | None
    """The grant register; None where the program waits for no grant: then no register is claimed."""
    left_out: tuple[str, ...]
    """Outputs this controller does not know, or was not asked for as its software is too old for them."""


def delivered_rate_hz(wanted_hz: float, major: int) -> float:
    """Return the whole fraction of the controller's own rate that is nearest to `wanted_hz`.

    The controller sends each n-th sample, so only such a rate gives an even time grid, in which a gap can be told.
    CB3 controllers (software 3) run at 125 Hz, all later ones at 500 Hz (RTDE guide).
    """
    own = CB3_RATE_HZ if major <= CB3_MAJOR else E_SERIES_RATE_HZ
    return own / max(1, round(own / wanted_hz))


def start_session(link: RtdeLink, config: RobotConfig) -> Session:
    """Agree on everything and start the stream.

    Raises
    ------
    ConnectError, ProtocolError, DeviceStateError
        As `bench.drivers.base.StateStream.open`.
    """
    try:
        return _agree(link, config)
    except ProtocolError as error:
        raise ProtocolError(f"The {link.peer} is not understood: {error.args[0]}", hint=error.hint) from error


def _agree(link: RtdeLink, config: RobotConfig) -> Session:
    _agree_on_protocol(link)
    version = decode_controller_version(link.ask(PackageType.CONTROLLER_VERSION))
    rate_hz = delivered_rate_hz(config.rate_hz, version[0])
    outputs, left_out = _set_up_outputs(link, config, rate_hz, too_new_outputs(version))
    inputs = _set_up_grant(link, config.cycle.grant_register) if config.cycle.is_granted else None
    if not decode_accepted(link.ask(PackageType.START)):
        raise DeviceStateError(
            f"The {link.peer} refuses to start its state stream.", hint="Restart the robot's controller."
        )
    return Session(version, rate_hz, outputs, inputs, left_out)


def _agree_on_protocol(link: RtdeLink) -> None:
    if not decode_accepted(link.ask(PackageType.PROTOCOL_VERSION, encode_protocol_version(2))):
        raise ProtocolError(
            "it does not speak RTDE protocol version 2.",
            hint="Update the controller's software (3.10 or 5.0 and later have it).",
        )


def _set_up_outputs(
    link: RtdeLink, config: RobotConfig, rate_hz: float, too_new: frozenset[str]
) -> tuple[Recipe, tuple[str, ...]]:
    """Ask for all that is not too new, and ask again without the names the controller does not know."""
    unknown = too_new.intersection(wanted_outputs(config.cycle, frozenset()))
    while True:
        names = wanted_outputs(config.cycle, unknown)
        recipe_id, types = decode_setup_reply(link.ask(PackageType.SETUP_OUTPUTS, encode_output_setup(names, rate_hz)))
        refused = frozenset(name for name, kind in zip(names, types, strict=False) if kind == NOT_FOUND)
        _verify_essential(link, config, refused)
        if not refused:
            return Recipe(names, types, recipe_id), tuple(sorted(unknown))
        unknown |= refused


def _verify_essential(link: RtdeLink, config: RobotConfig, refused: frozenset[str]) -> None:
    missing = sorted(refused & essential_outputs(config.cycle))
    if missing:
        raise DeviceStateError(
            f"The {link.peer} has no output {' and no output '.join(missing)}, which tells the cycles.",
            hint="Choose other registers in [robot.cycle] (old controllers have 0 to 23 only).",
        )


def _set_up_grant(link: RtdeLink, register: int) -> Recipe:
    name = f"input_int_register_{register}"
    recipe_id, types = decode_setup_reply(link.ask(PackageType.SETUP_INPUTS, encode_input_setup([name])))
    if IN_USE in types:
        raise DeviceStateError(
            f"The {link.peer} says that {name} is in use by somebody else: "
            "another RTDE client, or a fieldbus (EtherNet/IP, PROFINET, Modbus).",
            hint="Close the other client or switch the fieldbus off, or choose another [robot.cycle] grant_register.",
        )
    if NOT_FOUND in types:
        raise DeviceStateError(
            f"The {link.peer} has no {name}.", hint="Choose another [robot.cycle] grant_register (0 to 23 on old ones)."
        )
    if types != [GRANT_TYPE]:
        raise ProtocolError(f"it gives {name} the type '{','.join(types)}' where {GRANT_TYPE} is due.")
    return Recipe([name], types, recipe_id)
