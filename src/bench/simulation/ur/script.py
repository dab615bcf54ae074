"""The script port: a program that is sent there replaces the one that runs.

No script is interpreted. Of ur_rtde's control script the part is simulated that a client talks to: it takes commands
from a register and says in another when it is ready. A command to move ends it, which the client is told.
"""

from __future__ import annotations

import logging
import re
from collections.abc import Callable, MutableMapping

from bench.drivers.robot.ur.recipe import Value
from bench.simulation.outbox import Outbox

__all__ = ["ControlScript", "ScriptSession"]

logger = logging.getLogger(__name__)

LONGEST_SCRIPT = 1_048_576
NO_COMMAND, STOP = 0, 255
READY = 1
REGISTER_OFFSET = re.compile(r"reg_offset_int *=[^\n]*\n(\d+)")


class ScriptSession:
    """One client of the script port, which is never answered.

    Parameters
    ----------
    outbox : Outbox
        Of the connection; nothing is sent.
    run : callable
        Takes each whole program.
    """

    def __init__(self, outbox: Outbox, run: Callable[[str], None]) -> None:
        self._outbox = outbox
        self._run = run
        self._text = b""

    def receive(self, data: bytes) -> bool:
        """Take what is sent; False for a program that never ends. A program ends with ``end`` at a line's beginning."""
        self._text += data
        while (end := self._text.find(b"\nend\n")) >= 0:
            script, self._text = self._text[:end], self._text[end + len(b"\nend\n") :]
            self._run(script.decode(errors="replace"))
        return len(self._text) <= LONGEST_SCRIPT

    def close(self) -> None:
        """Forget the client; its program runs on."""


class ControlScript:
    """What a client sees of ur_rtde's control script while it runs.

    Parameters
    ----------
    offset : int
        Its first register: 0, or 24 of the upper range.
    """

    def __init__(self, offset: int) -> None:
        self._command_name = f"input_int_register_{offset}"
        self._state_name = f"output_int_register_{offset}"

    @classmethod
    def of(cls, text: str) -> ControlScript | None:
        """Return what runs when `text` is sent; None for a script of which nothing can be simulated."""
        match = REGISTER_OFFSET.search(text)
        return cls(int(match[1])) if match and int(match[1]) in (0, 24) else None

    def tick(self, values: MutableMapping[str, Value]) -> bool:
        """Take the command that waits, if one does; False when the script is over."""
        command = values[self._command_name]
        if command == NO_COMMAND:
            values[self._state_name] = READY
            return True
        if command != STOP:
            logger.info("the control script ends at command %s: the simulated controller moves by no script", command)
        return False
