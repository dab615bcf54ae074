"""ur_rtde's four classes, unmodified, each in a process of its own, against `bench simulate`."""

from __future__ import annotations

import json
import subprocess
import sys
import textwrap

import pytest

from bench.config import simulated_config, to_toml

ROBOT, TRACKER = "127.0.61.41", "127.0.61.42"
PATIENCE_S = 60.0
"""Only a limit: nothing waits that long."""

# Each prints one JSON value.
RECEIVE = """
    from rtde_receive import RTDEReceiveInterface
    robot = RTDEReceiveInterface(HOST, 500.0, [], False, True)
    first = robot.getTimestamp()
    while robot.getTimestamp() < first + 0.2:
        pass
    answer = [first, robot.getTimestamp(), robot.getActualQ(), robot.getRobotMode(), robot.getRuntimeState()]
    answer += [robot.getSafetyMode(), robot.getSafetyStatusBits(), robot.getPayload(), robot.getActualMainVoltage()]
    robot.disconnect()
    done(answer)
"""
WRITE = """
    import time
    from rtde_io import RTDEIOInterface
    from rtde_receive import RTDEReceiveInterface
    io = RTDEIOInterface(HOST, False, True)
    robot = RTDEReceiveInterface(HOST, 125.0, ["timestamp", "target_speed_fraction", "actual_digital_output_bits"])
    written = [io.setSpeedSlider(0.25), io.setStandardDigitalOut(3, True), io.setInputIntRegister(42, 7)]
    limit = time.monotonic() + 10
    while robot.getTargetSpeedFraction() != 0.25 and time.monotonic() < limit:
        time.sleep(0.002)
    while not robot.getDigitalOutState(3) and time.monotonic() < limit:
        time.sleep(0.002)
    answer = [written, robot.getTargetSpeedFraction(), robot.getDigitalOutState(3)]
    io.setSpeedSlider(1.0)
    io.setStandardDigitalOut(3, False)
    robot.disconnect()
    io.disconnect()
    done(answer)
"""
CONTROL = """
    from rtde_control import RTDEControlInterface
    control = RTDEControlInterface(HOST)
    answer = [control.isConnected(), control.isProgramRunning()]
    control.stopScript()
    answer.append(control.isProgramRunning())
    control.disconnect()
    done(answer)
"""
DRIVE = """
    import time
    from dashboard_client import DashboardClient
    board = DashboardClient(HOST)
    board.connect()
    answer = [board.isConnected(), board.polyscopeVersion(), board.robotmode(), board.safetystatus()]
    answer += [board.isInRemoteControl(), board.getSerialNumber()]

    def wait_for(is_so):
        limit = time.monotonic() + 10
        while not is_so() and time.monotonic() < limit:
            time.sleep(0.01)
        return is_so()

    board.loadURP("bend_test.urp")
    answer.append(wait_for(lambda: "bend_test.urp" in board.getLoadedProgram()))
    board.play()
    answer.append(wait_for(board.running))
    board.pause()
    answer.append(wait_for(lambda: board.programState().startswith("PAUSED")))
    board.play()
    answer.append(wait_for(lambda: board.programState().startswith("PLAYING")))
    board.stop()
    answer.append(wait_for(lambda: board.programState() == "STOPPED bend_test.urp"))
    board.disconnect()
    done(answer)
"""


@pytest.fixture(scope="module")
def served(tmp_path_factory):
    """Run `bench simulate` as anybody would."""
    pytest.importorskip("rtde_control", reason="ur_rtde is not installed")
    config = simulated_config()
    robot = config.robot.model_copy(update={"host": ROBOT})
    tracker = config.tracker.model_copy(update={"host": TRACKER})
    path = tmp_path_factory.mktemp("simulated") / "bench.toml"
    path.write_text(to_toml(config.model_copy(update={"robot": robot, "tracker": tracker})), encoding="utf-8")
    command = [sys.executable, "-m", "bench", "simulate", str(path), "--until-stdin-closes"]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
        lines = [process.stdout.readline() for _ in range(2)]
        assert lines[0].startswith("ready robot")
        yield
        process.communicate(timeout=PATIENCE_S)


def run_client(code):
    head = f"import json\nHOST = {ROBOT!r}\ndone = lambda answer: print(json.dumps(answer))\n"
    command = [sys.executable, "-c", head + textwrap.dedent(code)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE_S, check=False)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout.splitlines()[-1])


@pytest.mark.usefixtures("served")
def test_the_receive_interface_reads_the_default_recipe_at_500_hz_with_the_upper_registers():
    first, later, joints, *modes, payload, voltage = run_client(RECEIVE)
    assert 61 < first < later
    assert later * 500 == pytest.approx(round(later * 500), abs=1e-6)
    assert len(joints) == 6
    assert modes == [7, 1, 1, 1]
    assert (payload, voltage) == (0.4, 48.0)


@pytest.mark.usefixtures("served")
def test_the_io_interface_writes_slider_outputs_and_registers():
    assert run_client(WRITE) == [[True, True, True], 0.25, True]


@pytest.mark.usefixtures("served")
def test_the_control_interface_uploads_its_script_and_ends_it():
    assert run_client(CONTROL) == [True, True, False]


@pytest.mark.usefixtures("served")
def test_the_dashboard_client_loads_plays_pauses_and_stops_the_program():
    connected, version, mode, safety, remote, serial, *reached = run_client(DRIVE)
    assert (connected, mode, safety, remote) == (True, "Robotmode: RUNNING", "Safetystatus: NORMAL", True)
    assert "5.15" in version
    assert serial.isdigit()
    assert reached == [True] * 5
