"""The RTDE server: one session per client, input variables owned by one client each."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable

from bench.drivers.robot.ur.codec import (
    IN_USE,
    NAME_LIST_LIMIT,
    NOT_FOUND,
    FrameSplitter,
    PackageType,
    TextMessage,
    decode_input_setup,
    decode_output_setup,
    decode_protocol_version,
    decode_text,
    encode_accepted,
    encode_controller_version,
    encode_frame,
    encode_setup_reply,
    encode_text,
)
from bench.drivers.robot.ur.recipe import Recipe
from bench.drivers.robot.ur.versions import find_since
from bench.errors import ProtocolError
from bench.simulation.ur.machine import Machine
from bench.simulation.ur.outbox import Outbox
from bench.simulation.ur.variables import INPUT_TYPES, OUTPUT_TYPES

__all__ = ["RtdeServer", "RtdeSession"]

logger = logging.getLogger(__name__)

LARGEST_RECIPE_ID = 255


class RtdeServer:
    """What all sessions share.

    Parameters
    ----------
    machine : Machine
        The robot.
    rate_hz : float
        Ticks a second, the highest rate a client can have.
    """

    def __init__(self, machine: Machine, rate_hz: float) -> None:
        self.machine = machine
        self.rate_hz = rate_hz
        self.owners: dict[str, RtdeSession | None] = {}
        """Who writes each input variable that is claimed, None: a fieldbus; the network's thread only."""
        self._sessions: tuple[RtdeSession, ...] = ()
        self._lock = threading.Lock()

    def add(self, session: RtdeSession) -> None:
        with self._lock:
            self._sessions = (*self._sessions, session)

    def remove(self, session: RtdeSession) -> None:
        """Forget a client that is gone, and release its inputs; their values stay."""
        with self._lock:
            self._sessions = tuple(other for other in self._sessions if other is not session)
        for name in [name for name, owner in self.owners.items() if owner is session]:
            del self.owners[name]

    def claim(self, name: str) -> None:
        """Let an input belong to a fieldbus. `ValueError` if there is no such input, or it is claimed."""
        if name not in INPUT_TYPES:
            raise ValueError(f"there is no {name}")
        if name in self.owners:
            raise ValueError(f"{name} is in use")
        self.owners[name] = None

    def release(self, name: str) -> None:
        """End what `claim` began. `ValueError` if it did not."""
        if name not in self.owners or self.owners[name] is not None:
            raise ValueError(f"{name} is not held")
        del self.owners[name]

    def hold_packages(self) -> None:
        """Keep everything for the clients that are connected until `release_packages`."""
        for session in self._sessions:
            session.outbox.hold()

    def release_packages(self) -> None:
        """Send at once what was held."""
        for session in self._sessions:
            session.outbox.release()

    def send_packages(self, tick_number: int, now_ns: int) -> None:
        """Send the tick to every client whose turn it is; the scheduler's thread."""
        for session in self._sessions:
            session.send_tick(tick_number, now_ns)


class RtdeSession:
    """One client: its protocol version, recipes and whether it is started."""

    def __init__(self, server: RtdeServer, outbox: Outbox) -> None:
        self._server = server
        self.outbox = outbox
        """Takes what is sent to this client."""
        self._splitter = FrameSplitter()
        self._protocol = 1
        self._outputs: Recipe | None = None
        self._inputs: dict[int, Recipe] = {}
        self._every = 1
        self._is_started = False
        self._answers: dict[int, Callable[[bytes], None]] = {
            PackageType.PROTOCOL_VERSION: self._choose_protocol,
            PackageType.CONTROLLER_VERSION: self._tell_version,
            PackageType.SETUP_OUTPUTS: self._set_up_outputs,
            PackageType.SETUP_INPUTS: self._set_up_inputs,
            PackageType.START: self._start,
            PackageType.PAUSE: self._pause,
            PackageType.DATA: self._take_inputs,
            PackageType.TEXT: self._log_text,
        }

    def receive(self, data: bytes) -> bool:
        """Answer what `data` completes; False if this client speaks no RTDE. The network's thread."""
        try:
            for kind, payload in self._splitter.feed(data):
                self._answers[kind](payload)
        except ProtocolError as error:
            logger.info("an RTDE client is cut off: %s", error)
            return False
        return True

    def close(self) -> None:
        """Forget a client that is gone."""
        self._is_started = False
        self._server.remove(self)

    def send_tick(self, tick_number: int, now_ns: int) -> None:
        """Send this client's variables if it is started and its turn; the scheduler's thread."""
        recipe = self._outputs
        if self._is_started and recipe is not None and tick_number % self._every == 0:
            values = self._server.machine.values
            payload = recipe.encode([values[name] for name in recipe.names])
            self.outbox.send_package(encode_frame(PackageType.DATA, payload), now_ns)
        elif not self.outbox.is_empty:
            self.outbox.flush(now_ns)

    def _reply(self, kind: PackageType, payload: bytes) -> None:
        self.outbox.send(encode_frame(kind, payload))

    def _choose_protocol(self, payload: bytes) -> None:
        version = decode_protocol_version(payload)
        is_known = version in (1, 2)
        if is_known:
            self._protocol = version
        self._reply(PackageType.PROTOCOL_VERSION, encode_accepted(is_known))

    def _tell_version(self, _payload: bytes) -> None:
        self._reply(PackageType.CONTROLLER_VERSION, encode_controller_version(self._server.machine.kind.version))

    def _set_up_outputs(self, payload: bytes) -> None:
        """Set up a recipe in the place of any earlier one; one unknown name refuses the whole of it."""
        rate_hz, names = decode_output_setup(payload, self._protocol)
        types = [self._output_type(name) for name in names]
        is_refused = not self._fits(payload) or NOT_FOUND in types or not names
        self._is_started = False
        recipe_id = 1 if self._protocol == 2 else None
        self._outputs = None if is_refused else Recipe(names, types, recipe_id)
        self._every = max(1, round(self._server.rate_hz / rate_hz)) if rate_hz >= 1.0 else round(self._server.rate_hz)
        refused_id = 0 if self._protocol == 2 else None
        self._reply(PackageType.SETUP_OUTPUTS, encode_setup_reply(refused_id if is_refused else recipe_id, types))

    def _output_type(self, name: str) -> str:
        is_too_new = find_since(name, self._server.machine.kind.version) != ""
        return NOT_FOUND if is_too_new else OUTPUT_TYPES.get(name, NOT_FOUND)

    def _fits(self, payload: bytes) -> bool:
        if len(payload) <= NAME_LIST_LIMIT + 8:
            return True
        self._complain(f"the list of variables exceeds {NAME_LIST_LIMIT} bytes")
        return False

    def _set_up_inputs(self, payload: bytes) -> None:
        """Claim inputs: all of them, or none if one is unknown or somebody else's."""
        names = decode_input_setup(payload)
        types = [self._input_type(name) for name in names]
        recipe_id = len(self._inputs) + 1
        is_refused = not self._fits(payload) or NOT_FOUND in types or IN_USE in types or not names
        if is_refused or recipe_id > LARGEST_RECIPE_ID:
            self._reply(PackageType.SETUP_INPUTS, encode_setup_reply(0, types))
            return
        self._server.owners.update(dict.fromkeys(names, self))
        self._inputs[recipe_id] = Recipe(names, types, recipe_id)
        self._reply(PackageType.SETUP_INPUTS, encode_setup_reply(recipe_id, types))

    def _input_type(self, name: str) -> str:
        if self._server.owners.get(name, self) is not self:
            return IN_USE
        return INPUT_TYPES.get(name, NOT_FOUND)

    def _start(self, _payload: bytes) -> None:
        is_ready = self._outputs is not None
        self._reply(PackageType.START, encode_accepted(is_ready))
        self._is_started = is_ready

    def _pause(self, _payload: bytes) -> None:
        self._is_started = False
        self._reply(PackageType.PAUSE, encode_accepted(True))

    def _take_inputs(self, payload: bytes) -> None:
        recipe = self._inputs.get(payload[0]) if payload else None
        if recipe is None:
            self._complain("inputs of a recipe that is not set up")
            return
        try:
            self._server.machine.write_inputs(recipe.decode(payload))
        except ProtocolError as error:
            self._complain(str(error))

    def _complain(self, text: str) -> None:
        if self._protocol == 2:
            self._reply(PackageType.TEXT, encode_text(TextMessage(text, "RTDE", 1)))

    def _log_text(self, payload: bytes) -> None:
        logger.info("an RTDE client says: %s", decode_text(payload).text if self._protocol == 2 else payload)
