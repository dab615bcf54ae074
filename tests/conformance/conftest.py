"""Which devices the conformance tests run on: the simulated ones always, real ones where they are named."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from rigs import (
    PROGRAM,
    RobotRig,
    TrackerRig,
    fake_robot,
    modbus_robot,
    real_robot,
    real_tracker,
    simulated_qtm,
    simulated_robot,
    simulated_tracker,
)

REAL = pytest.param("real", marks=pytest.mark.hardware)


def _address(request: pytest.FixtureRequest, option: str) -> str:
    address = request.config.getoption(option)
    if not address:
        pytest.skip(f"needs a real device: -m hardware {option} HOST")
    return str(address)


@pytest.fixture(params=["fake", "e-series", "cb3", "polyscope-x", "modbus", REAL])
def rig(request: pytest.FixtureRequest) -> Iterator[RobotRig]:
    """Return a robot that is ready and stands, not yet connected."""
    if request.param == "fake":
        made = fake_robot()
    elif request.param == "modbus":
        made = modbus_robot()
    elif request.param == "real":
        program = request.config.getoption("--program") or PROGRAM
        made = real_robot(_address(request, "--robot"), program)
    else:
        made = simulated_robot(request.param)
    with made as robot:
        try:
            yield robot
        finally:
            robot.close()


@pytest.fixture(params=["natnet", "qualisys", REAL])
def tracker(request: pytest.FixtureRequest) -> Iterator[TrackerRig]:
    """Return a tracker that streams, not yet connected."""
    simulated = {"natnet": simulated_tracker, "qualisys": simulated_qtm}.get(request.param)
    with simulated() if simulated else real_tracker(_address(request, "--tracker")) as rig:
        try:
            yield rig
        finally:
            rig.stream.close()
