"""What may go wrong with a simulated Modbus controller, on command: for tests of whoever talks to it."""

from __future__ import annotations

from collections.abc import Callable

from bench.simulation.modbus.logic import PlcLogic
from bench.simulation.modbus.server import TableServer
from bench.simulation.ur.faults import wait_for

__all__ = ["PlcFaults"]

EXCEPTION_CODES = (1, 2, 3, 4, 5, 6, 7, 8, 10, 11)
"""Those that exist (Modbus application protocol 1.1b3, section 7)."""


class PlcFaults:
    """Faults of one controller and its server. Each call returns when registers and answers show it.

    Durations are in the machine's own seconds, as the limits are that clients have for a link. Any thread but the
    scheduler's.

    Parameters
    ----------
    logic : PlcLogic
        The controller's own program.
    server : TableServer
        Its Modbus server.
    at_scan : callable
        Takes an action for the beginning of the next scan.
    """

    def __init__(self, logic: PlcLogic, server: TableServer, at_scan: Callable[[Callable[[], None]], None]) -> None:
        self._logic = logic
        self._server = server
        self._at_scan = at_scan

    def set_late(self, delay_s: float) -> None:
        """Give every answer so much late; 0 ends it."""
        self._server.delay_s = delay_s

    def refuse(self, code: int) -> None:
        """Answer every request by this exception; 0 ends it. `ValueError` if there is no such exception."""
        if code and code not in EXCEPTION_CODES:
            raise ValueError(f"there is no exception {code}; {', '.join(map(str, EXCEPTION_CODES))} exist, 0 ends it")
        self._server.exception_code = code

    def freeze(self, is_frozen: bool) -> None:
        """Accept clients and take requests, but answer none, as a controller that is overloaded; or end that."""
        self._server.is_frozen = is_frozen

    def drop(self) -> None:
        """Close all connections; new ones are welcome."""
        self._server.drop_connections()

    def set_fault(self, code: int) -> None:
        """Stop the program and show a fault; 0 clears it."""
        self._act(lambda: setattr(self._logic, "fault_code", code))

    def open_interlock(self, name: str) -> None:
        """Open an interlock. `ValueError` if the register map has none of that name."""
        self._verify_interlock(name)
        self._act(lambda: self._logic.open_interlocks.add(name))

    def close_interlock(self, name: str) -> None:
        """Put it in order again. `ValueError` if the register map has none of that name."""
        self._verify_interlock(name)
        self._act(lambda: self._logic.open_interlocks.discard(name))

    def set_heartbeat(self, beats: bool) -> None:
        """Let the controller's own heartbeat go on, or stand still."""
        self._act(lambda: setattr(self._logic, "beats", beats))

    def set_override(self, fraction: float) -> None:
        """Change the speed override at the panel."""
        self._act(lambda: setattr(self._logic, "override", fraction))

    def show_state(self, value: int | None) -> None:
        """Show this in the state register, whatever the program does; None ends it."""
        self._act(lambda: setattr(self._logic, "shown_state", value))

    def set_counter(self, count: int) -> None:
        """Let the cycle counter go on from here: a register written by another client, or close to its end."""
        self._act(lambda: self._logic.set_counter(count))

    def pause(self) -> None:
        """Pause the program at the controller's panel."""
        self._act(self._logic.program.pause)

    def resume(self) -> None:
        """Let a paused program go on, at the panel."""
        self._act(self._logic.resume)

    def stop(self) -> None:
        """Stop the program at the panel."""
        self._act(self._logic.program.stop)

    def reboot(self) -> None:
        """Switch off and on: every register 0, its time too, the program stopped, all connections closed."""
        self._act(self._logic.reboot)
        self._server.drop_connections()

    def _act(self, effect: Callable[[], object]) -> None:
        wait_for(self._at_scan, effect)
        wait_for(self._at_scan, lambda: None)  # the scan after it has begun, so the first has been shown

    def _verify_interlock(self, name: str) -> None:
        names = self._logic.interlock_names
        if name not in names:
            raise ValueError(f"there is no interlock '{name}'; {', '.join(names) or 'none'} are mapped")
