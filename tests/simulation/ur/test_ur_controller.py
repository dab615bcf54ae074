"""The simulated controller behind its real ports, as its clients see it."""

from __future__ import annotations

import json
import socket
import struct
import subprocess
import sys
import textwrap
import threading

import pytest

from bench.errors import ConnectError
from bench.simulation.device_clock import DeviceClock
from bench.simulation.program import PathProgram
from bench.simulation.scheduler import Scheduler
from bench.simulation.ur import UrController
from bench.timing import RunClock

HOST = "127.0.31.11"


@pytest.fixture
def start_controller():
    clock = RunClock.start()
    scheduler = Scheduler(clock)
    controllers = []

    def start(host=HOST, **keys):
        controller_clock = DeviceClock(clock.now_ns(), 61_250_000_000, 1e9)
        controllers.append(
            UrController(host, PathProgram(), scheduler, clock, controller_clock=controller_clock, **keys)
        )
        controllers[-1].open()
        return controllers[-1]

    thread = threading.Thread(target=scheduler.run)
    thread.start()
    yield start
    for controller in controllers:
        controller.close()
    scheduler.stop()
    thread.join()


def read_line(link):
    line = b""
    while not line.endswith(b"\n"):
        line += link.recv(1)
    return line.decode().strip()


def test_a_port_in_use_is_one_sentence_and_nothing_stays_open(start_controller):
    start_controller()
    with pytest.raises(ConnectError, match=rf"cannot serve on {HOST}:30004, it is already in use"):
        start_controller()
    with pytest.raises(ConnectError, match="29999"):
        start_controller(rtde_port=30104)
    start_controller(rtde_port=30104, dashboard_port=29998)


def test_closing_frees_the_ports_and_may_be_repeated(start_controller):
    first = start_controller()
    with socket.create_connection((HOST, 29999), timeout=5) as client:
        read_line(client)
        first.close()
        first.close()
        assert client.recv(10) == b""
    start_controller()


def test_a_client_that_breaks_off_disturbs_no_other(start_controller):
    start_controller()
    with socket.create_connection((HOST, 29999), timeout=5) as steady:
        assert read_line(steady).startswith("Connected")
        for _ in range(5):
            rude = socket.create_connection((HOST, 30004), timeout=5)
            rude.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
            rude.sendall(b"\x00\x05V\x00")
            rude.close()
        with socket.create_connection((HOST, 30004), timeout=5) as garbage:
            garbage.sendall(b"GET / HTTP/1.1\r\n\r\n")
            assert garbage.recv(10) == b""
        steady.sendall(b"robotmode\n")
        assert read_line(steady) == "Robotmode: RUNNING"


# In a process of its own: the constructors of ur_rtde hold the GIL until the server has answered.
RECEIVE = """
    import json
    from rtde_receive import RTDEReceiveInterface
    robot = RTDEReceiveInterface({host!r}, {rate}, {names})
    first = robot.getTimestamp()
    while robot.getTimestamp() < first + 0.1:
        pass
    print(json.dumps([first, robot.getTimestamp(), robot.getActualQ(), robot.getRobotMode(), robot.getSafetyMode()]))
    robot.disconnect()
"""
WRITE_AND_DRIVE = """
    import json, time
    from dashboard_client import DashboardClient
    from rtde_io import RTDEIOInterface
    from rtde_receive import RTDEReceiveInterface
    board = DashboardClient({host!r})
    board.connect()
    board.loadURP("bend_test.urp")
    while "bend_test" not in board.getLoadedProgram():
        time.sleep(0.01)
    board.play()
    while not board.running():
        time.sleep(0.01)
    io = RTDEIOInterface({host!r})
    robot = RTDEReceiveInterface({host!r})
    io.setInputIntRegister(20, 1)
    io.setSpeedSlider(0.5)
    limit = time.monotonic() + 5
    while (robot.getTargetSpeedFraction() != 0.5 or max(robot.getActualQd()) < 0.01) and time.monotonic() < limit:
        time.sleep(0.005)
    fraction, speed = robot.getTargetSpeedFraction(), max(robot.getActualQd())
    board.stop()
    print(json.dumps([fraction, speed, robot.getSpeedScaling(), len(robot.getActualTCPPose())]))
    robot.disconnect()
    io.disconnect()
    board.disconnect()
"""


def run_client(code, **values):
    pytest.importorskip("dashboard_client")
    command = [sys.executable, "-c", textwrap.dedent(code).format(**values)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout.splitlines()[-1])


@pytest.mark.parametrize(
    ("rate", "names"), [(-1.0, []), (125.0, ["timestamp", "actual_q", "robot_mode", "safety_mode"])]
)
def test_ur_rtde_receives_from_it(start_controller, rate, names):
    start_controller()
    first, later, joints, mode, safety = run_client(RECEIVE, host=HOST, rate=rate, names=names)
    assert 61 < first < later
    assert later * 500 == pytest.approx(round(later * 500), abs=1e-6)
    assert joints == pytest.approx(PathProgram().motion_at(0).q_rad)
    assert (mode, safety) == (7, 1)


def test_ur_rtde_writes_to_it_and_drives_it(start_controller):
    start_controller(grant_register=20)
    fraction, speed, scaling, n_pose = run_client(WRITE_AND_DRIVE, host=HOST)
    assert (fraction, scaling, n_pose) == (0.5, 1.0, 6)
    assert speed > 0


@pytest.mark.parametrize(("remote_control", "state"), [(True, "PLAYING"), (False, "STOPPED")])
def test_a_script_is_run_in_remote_control_only(start_controller, remote_control, state):
    controller = start_controller(remote_control=remote_control)
    with socket.create_connection((HOST, 30003), timeout=5) as link:
        link.sendall(b"def script():\nreg_offset_int = \n0\nend\n")
        link.shutdown(socket.SHUT_WR)
        assert link.recv(10) == b""
    controller.act(lambda _host_ns: None)
    assert controller.machine.state == state
