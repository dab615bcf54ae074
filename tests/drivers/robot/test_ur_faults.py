"""What our driver reports for each fault that the admin channel of the simulated bench can make, at the wire."""

from __future__ import annotations

import itertools
import socket
import threading

import pytest

from bench.config import RobotConfig
from bench.drivers.robot.ur.state import UrStateStream
from bench.errors import ConnectError, DeviceStateError
from bench.model import Severity
from bench.simulation.admin import AdminServer
from bench.timing import RunClock

ROBOT = "127.0.61.11"
ADMIN_PORT = 30099
PROGRAM = "bend_test.urp"


class Admin:
    """A person with a terminal: one line, one answer."""

    def __init__(self):
        self._link = socket.create_connection((ROBOT, ADMIN_PORT), timeout=10)
        self._lines = self._link.makefile("r")

    def __call__(self, command):
        self._link.sendall(f"{command}\n".encode())
        return self._lines.readline().strip()

    def read_all(self, command):
        lines = [self(command)]
        while lines[-1] != "ok":
            lines.append(self._lines.readline().strip())
        return lines[:-1]

    def close(self):
        self._lines.close()
        self._link.close()


class FakeTracker:
    def __init__(self):
        self.stalls = []

    def stall(self, duration_s):
        self.stalls.append(duration_s)


@pytest.fixture
def clock():
    return RunClock.start()


@pytest.fixture
def controller(start_controller):
    return start_controller(ROBOT)


@pytest.fixture
def tracker():
    return FakeTracker()


@pytest.fixture
def admin(controller, tracker, clock):
    server = AdminServer(ROBOT, ADMIN_PORT, controller, tracker, clock)
    server.open()
    person = Admin()
    yield person
    person.close()
    server.close()


class Link:
    """Our driver on the simulated controller, and all it reports."""

    def __init__(self, sink, clock, **keys):
        self.sink = sink
        self.lost, self.missed = [], []
        self.n_restored = 0
        self._changed = threading.Condition()
        self.stream = UrStateStream(
            RobotConfig(host=ROBOT, program=PROGRAM, rate_hz=125.0),
            clock,
            on_missed=lambda _topic, n: self._note(self.missed, n),
            on_lost=lambda error: self._note(self.lost, str(error)),
            on_restored=self._restored,
            **({"reconnect_s": 20.0, "silence_s": 0.3, "connect_timeout_s": 0.5} | keys),
        )
        self.stream.open(sink)

    def _note(self, notes, note):
        with self._changed:
            notes.append(note)
            self._changed.notify_all()

    def _restored(self):
        with self._changed:
            self.n_restored += 1
            self._changed.notify_all()

    def wait(self, condition):
        with self._changed:
            assert self._changed.wait_for(condition, 20.0)

    def wait_for_samples(self, n=5):
        n_before = len(self.sink.samples)
        self.sink.wait_for(lambda: len(self.sink.samples) >= n_before + n)

    def said(self, text):
        return [entry for entry in self.sink.logs if text in entry.text]


@pytest.fixture
def connect(controller, clock, sink):
    links = []

    def start(**keys):
        links.append(Link(sink, clock, **keys))
        links[-1].wait_for_samples()
        return links[-1]

    yield start
    for link in links:
        link.stream.close()


@pytest.fixture
def link(connect):
    return connect()


def play(controller):
    controller.act(controller.machine.load)
    controller.act(controller.machine.play)


def all_missed(link):
    """Return how many samples the recording lacks by the controller's own grid."""
    numbers = [sample.sequence for sample in link.sink.samples]
    return sum(after - before - 1 for before, after in itertools.pairwise(numbers))


# Links


def test_a_short_stall_is_a_gap_that_is_counted_and_told(admin, link):
    assert admin("stall 0.1") == "ok"
    link.wait(lambda: link.missed)
    assert link.missed == [all_missed(link)]
    assert link.missed[0] >= 10
    assert link.said(f"{link.missed[0]} samples never came")
    assert not link.lost


def test_a_long_stall_is_a_lost_link_that_comes_back(admin, link):
    assert admin("stall 0.6") == "ok"
    link.wait(lambda: link.n_restored == 1)
    link.wait_for_samples()
    assert len(link.lost) == 1
    assert "sent nothing for 0.3 s" in link.lost[0]
    assert [entry.severity for entry in link.said("sent nothing")][:1] == [Severity.ERROR]
    assert link.missed == [all_missed(link)]
    assert link.sink.samples[-1].segment > 0


@pytest.mark.parametrize(("command", "told"), [("fin", "closed the connection"), ("rst", "reset by peer")])
def test_a_connection_that_ends_is_told_and_made_again(admin, link, command, told):
    assert admin(command) == "ok"
    link.wait(lambda: link.n_restored == 1)
    link.wait_for_samples()
    assert len(link.lost) == 1
    assert told in link.lost[0]
    assert link.said("is back after")
    assert sum(link.missed) == all_missed(link) > 0
    assert link.sink.samples[-1].segment == 1


def test_a_half_open_controller_is_given_up_within_the_limit_and_found_again_later(admin, link, connect):
    assert admin("half_open on") == "ok"
    with pytest.raises(ConnectError, match=r"did not answer RTDE package 'V' in 0\.5 s"):
        connect()
    assert admin("fin") == "ok"
    link.sink.wait_for(lambda: link.said("accepts the connection but did not answer"))
    assert admin("half_open off") == "ok"
    link.wait(lambda: link.n_restored == 1)


def test_a_burst_is_late_but_whole(admin, link):
    n_before = len(link.sink.samples)
    assert admin("burst 0.2") == "ok"
    link.wait_for_samples(60)
    arrivals = [sample.arrival_ns for sample in link.sink.samples[n_before - 1 :]]
    assert max(after - before for before, after in itertools.pairwise(arrivals)) > 100_000_000
    assert all_missed(link) == 0
    assert not link.missed
    assert not link.lost


def test_delayed_samples_are_late_whole_and_in_order_until_the_delay_ends(admin, link):
    def lag_s(sample):
        return sample.arrival_ns * 1e-9 - sample.controller_time_s

    usual_s = min(lag_s(sample) for sample in link.sink.samples)
    assert admin("delay 0.15") == "ok"
    link.sink.wait_for(lambda: lag_s(link.sink.samples[-1]) - usual_s > 0.14)
    assert admin("delay 0") == "ok"
    link.sink.wait_for(lambda: lag_s(link.sink.samples[-1]) - usual_s < 0.1)
    assert all_missed(link) == 0
    assert not link.lost


def test_skipped_samples_are_counted(admin, link):
    assert admin("skip 7") == "ok"
    link.wait(lambda: link.missed)
    assert link.missed == [7]
    assert link.said("7 samples never came")


def test_a_reboot_is_told_and_the_grant_is_not_given_again(admin, controller, link):
    link.stream.grant_cycles(1)
    assert admin("reboot") == "ok"
    link.wait(lambda: link.n_restored == 1)
    link.wait_for_samples()
    assert link.said("restarted: its time went from 6")
    assert link.said("is not the one that was granted 1 cycles")
    assert link.sink.samples[-1].controller_time_s < 60
    assert (link.sink.samples[-1].robot_mode, link.sink.samples[-1].cycle_count) == (3, 0)
    controller.act(controller.machine.release_brakes)
    play(controller)
    link.wait_for_samples(20)
    assert {sample.cycle_running for sample in link.sink.samples[-15:]} == {0}


def test_a_lost_link_does_not_interrupt_the_cycles_that_were_granted(admin, controller, link):
    play(controller)
    link.stream.grant_cycles(1)
    link.sink.wait_for(lambda: link.sink.samples[-1].cycle_running == 1)
    assert admin("rst") == "ok"
    link.wait(lambda: link.n_restored == 1)
    link.sink.wait_for(lambda: link.sink.samples[-1].cycle_count == 1)
    link.stream.grant_cycles(2)
    link.sink.wait_for(lambda: link.sink.samples[-1].cycle_count == 2)
    assert not link.said("is not the one")


def test_a_register_that_another_client_holds_is_told_and_can_be_released(admin, connect):
    assert admin("hold_register 24") == "ok"
    with pytest.raises(DeviceStateError, match="input_int_register_24 is in use by somebody else"):
        connect()
    assert admin("hold_register 24") == "error: input_int_register_24 is in use"
    assert admin("release_register 24") == "ok"
    connect()
    assert admin("hold_register 24") == "error: input_int_register_24 is in use"
    assert admin("release_register 24") == "error: input_int_register_24 is not held"
    assert admin("hold_register 99") == "error: there is no input_int_register_99"


# The robot


@pytest.mark.parametrize(
    ("command", "status", "bit", "runtime", "mode"),
    [("protective_stop", 3, 2, 4, 7), ("safeguard_stop on", 5, 4, 4, 7), ("emergency_stop", 7, 6, 1, 3)],
)
def test_a_stop_by_the_safety_system_is_in_every_sample(admin, controller, link, command, status, bit, runtime, mode):
    play(controller)
    link.sink.wait_for(lambda: link.sink.samples[-1].runtime_state == 2)
    assert admin(command) == "ok"
    link.sink.wait_for(lambda: link.sink.samples[-1].safety_status == status)
    link.wait_for_samples()
    last = link.sink.samples[-1]
    assert (last.runtime_state, last.robot_mode) == (runtime, mode)
    assert last.safety_status_bits & 1 << bit
    assert last.safety_status_bits & 1 << 10


def test_a_closed_door_lets_the_program_go_on(admin, controller, link):
    play(controller)
    assert admin("safeguard_stop on") == "ok"
    link.sink.wait_for(lambda: link.sink.samples[-1].runtime_state == 4)
    assert admin("safeguard_stop off") == "ok"
    link.sink.wait_for(lambda: link.sink.samples[-1].runtime_state == 2)
    assert link.sink.samples[-1].safety_status == 1


def test_a_pause_at_the_pendant_and_its_end_are_in_the_samples(admin, controller, link):
    play(controller)
    assert admin("pause") == "ok"
    link.sink.wait_for(lambda: link.sink.samples[-1].runtime_state == 4)
    assert admin("resume") == "ok"
    link.sink.wait_for(lambda: link.sink.samples[-1].runtime_state == 2)


def test_the_slider_is_in_the_samples(admin, link):
    assert admin("slider 0.5") == "ok"
    link.sink.wait_for(lambda: link.sink.samples[-1].speed_fraction == 0.5)


def ask_dashboard(*lines):
    """Return the answers of the dashboard to one new client."""
    with socket.create_connection((ROBOT, 29999), timeout=10) as link, link.makefile("r") as answers:
        answers.readline()
        link.sendall("".join(f"{line}\n" for line in lines).encode())
        return [answers.readline().strip() for _ in lines]


def test_another_program_at_the_pendant_ends_ours_and_is_named(admin, controller, link):
    play(controller)
    assert admin("foreign_program welding.urp") == "ok"
    link.sink.wait_for(lambda: link.sink.samples[-1].runtime_state == 1)
    assert ask_dashboard("get loaded program", "programState", "play") == [
        "Loaded program: /programs/welding.urp",
        "STOPPED welding.urp",
        "Failed to execute: play",
    ]
    controller.act(controller.machine.load)
    assert ask_dashboard("programState") == [f"STOPPED {PROGRAM}"]


def test_local_mode_is_told_by_the_dashboard_to_who_asks(admin):
    assert admin("local on") == "ok"
    is_remote, answer = ask_dashboard("is in remote control", "play")
    assert is_remote == "false"
    assert answer.startswith("Command is not allowed due to safety reasons")
    assert admin("local off") == "ok"
    assert ask_dashboard("is in remote control") == ["true"]


# The channel itself


def test_help_names_every_command(admin):
    lines = admin.read_all("help")
    names = {line.split()[0] for line in lines}
    links = {"stall", "burst", "delay", "skip", "fin", "rst", "half_open", "hold_register", "release_register"}
    robot = {"reboot", "protective_stop", "safeguard_stop", "emergency_stop", "slider", "local", "foreign_program"}
    tracker = {f"tracker_{what}" for what in ("stall", "restart", "version", "body", "jump", "lose", "double")}
    assert names == links | robot | {"pause", "resume", "told"} | tracker


@pytest.mark.parametrize(
    ("command", "answer"),
    [
        ("", "error: there is no ''; 'help' lists the commands"),
        ("explode", "error: there is no 'explode'; 'help' lists the commands"),
        ("stall", "error: 'stall SECONDS' is expected"),
        ("reboot now", "error: 'reboot' is expected"),
        ("stall -1", "error: '-1' is not seconds of the machine's own time from 0 to 3600"),
        ("stall soon", "error: 'soon' is not seconds of the machine's own time from 0 to 3600"),
        ("slider 1.5", "error: '1.5' is not a fraction from 0 to 1"),
        ("slider nan", "error: 'nan' is not a fraction from 0 to 1"),
        ("skip 1.5", "error: '1.5' is not a number from 0 to 1000000"),
        ("local maybe", "error: 'maybe' is neither 'on' nor 'off'"),
    ],
)
def test_a_command_that_cannot_be_obeyed_is_told_why(admin, command, answer):
    assert admin(command) == answer


def test_what_clients_commanded_and_granted_is_told(admin, link):
    link.stream.grant_cycles(3)
    ask_dashboard("robotmode", "load bend_test.urp", "unlock protective stop")
    link.wait_for_samples()
    assert sorted(admin.read_all("told")) == ["grant 0", "grant 3", "load bend_test.urp", "unlock protective stop"]


def test_the_tracker_obeys_too(admin, tracker):
    assert admin("tracker_stall 2.5") == "ok"
    assert tracker.stalls == [2.5]


def test_the_admin_is_served_while_the_robot_is_not(admin):
    assert admin("stall 3600") == "ok"
    assert admin("local on") == "ok"


def test_an_admin_port_in_use_is_one_sentence(controller, tracker, clock):
    with socket.create_server((ROBOT, ADMIN_PORT)):
        server = AdminServer(ROBOT, ADMIN_PORT, controller, tracker, clock)
        with pytest.raises(ConnectError, match=f"{ROBOT}:{ADMIN_PORT}"):
            server.open()
