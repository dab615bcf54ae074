"""The program that the controller gives out, against the copy of it and against an earlier run's."""

from __future__ import annotations

import hashlib
from dataclasses import replace
from pathlib import Path

from fake_robot import FakeRobot

from bench.config import ProgramFile, simulated_config
from bench.errors import LinkLostError
from bench.run.loaded_program import ask_loaded, doubt_loaded
from bench.run.resume import Origin
from bench.timing import ManualClock

CONTENT = b'{"a program": 1}'
TOLD = {"loaded": "bend", "loaded_bytes": "16", "loaded_sha256": hashlib.sha256(CONTENT).hexdigest()}
COPY = ProgramFile("bend.urpx", CONTENT)
ORIGIN = Origin(Path("a.mcap"), "r1", simulated_config(), 1, 1, TOLD)


def test_equal_programs_are_not_doubted() -> None:
    assert doubt_loaded(TOLD, COPY, ORIGIN) == []


def test_another_copy_and_another_program_than_before_are_told() -> None:
    before = replace(ORIGIN, program_facts=TOLD | {"loaded_sha256": "0" * 64})
    copy, earlier = doubt_loaded(TOLD, ProgramFile("bend.urpx", CONTENT + b" "), before)
    assert copy.startswith("The copy bend.urpx is not what the controller gives out as 'bend'")
    assert earlier.startswith("The controller's program 'bend' is not the one that a.mcap was driven with")


class Controller(FakeRobot):
    """A controller that tells of its program, or fails to."""

    def tell_loaded(self) -> dict[str, str]:
        if self.link_broken:
            raise LinkLostError("The controller is gone.")
        return TOLD


def test_a_controller_that_does_not_answer_ends_no_run() -> None:
    robot = Controller(ManualClock())
    assert ask_loaded(robot, COPY, ORIGIN) == (TOLD, [])
    robot.link_broken = True
    assert ask_loaded(robot, COPY, ORIGIN) == (
        {},
        ["Of the loaded program only the name is known: The controller is gone."],
    )
    assert ask_loaded(FakeRobot(ManualClock()), COPY, ORIGIN) == ({}, [])


def test_what_cannot_be_compared_is_not_doubted() -> None:
    before = replace(ORIGIN, program_facts={"loaded": "bend"})
    assert doubt_loaded(TOLD, ProgramFile("bend.zip", b"PK"), before) == []
    assert doubt_loaded({"loaded": "bend"}, COPY, ORIGIN) == []
    assert doubt_loaded(TOLD, None, None) == []
