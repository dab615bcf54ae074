from __future__ import annotations

import threading
import time

import pytest

from bench.drivers.robot import make_state_stream
from bench.drivers.robot.ur.codec import PackageType, TextMessage, encode_frame, encode_text
from bench.drivers.robot.ur.recipe import Recipe
from bench.drivers.robot.ur.state import UrStateStream
from bench.errors import LinkLostError
from bench.model import Severity
from bench.simulation.ur.variables import initial_values
from bench.timing import RunClock

HOST = "127.0.61.1"
PERIOD_S = 1 / 125


def samples(names, types, begin_s, n=1, **values):
    """Return `n` data packages on the grid from `begin_s` on."""
    recipe = Recipe(names, types, 1)
    state = initial_values() | {"runtime_state": 2} | values
    packages = []
    for tick in range(n):
        state["timestamp"] = begin_s + tick * PERIOD_S
        packages.append(encode_frame(PackageType.DATA, recipe.encode([state[name] for name in names])))
    return b"".join(packages)


class Restorations:
    """An `on_restored` callback that can be waited on."""

    def __init__(self):
        self.count = 0
        self._called = threading.Condition()

    def __call__(self):
        with self._called:
            self.count += 1
            self._called.notify_all()

    def wait(self, count=1):
        with self._called:
            assert self._called.wait_for(lambda: self.count >= count, 10.0), "the link was not restored"


@pytest.fixture
def clock():
    return RunClock.start()


@pytest.fixture
def restored():
    return Restorations()


@pytest.fixture
def run(scripted, rtde_script, make_config, clock, sink, losses, restored):
    """Open a stream on a controller that hangs up after its first samples and then is what `later` says."""
    streams = []
    go = threading.Event()

    def start(*later, first=None, granted=0, reconnect_s=10.0, on_missed=None, silence_s=1.0):
        def before(link, names, types):
            link.sendall(samples(names, types, 61.0, 3, **(first or {})))

            def hang_up():
                go.wait(5)
                link.shutdown(2)

            threading.Thread(target=hang_up).start()

        server = scripted(HOST, rtde_script(after=before), *later)
        stream = UrStateStream(
            make_config(HOST, rtde_port=server.port),
            clock,
            on_missed=on_missed,
            on_lost=losses,
            on_restored=restored,
            reconnect_s=reconnect_s,
            silence_s=silence_s,
        )
        streams.append(stream)
        stream.open(sink)
        sink.wait_for(lambda: len(sink.samples) == 3)
        stream.grant_cycles(granted)
        go.set()
        losses.wait()
        return stream

    yield start
    for stream in streams:
        stream.close()


def later(rtde_script, begin_s=61.304, n=3, **values):
    return rtde_script(after=lambda link, names, types: link.sendall(samples(names, types, begin_s, n, **values)))


def wait_for_grant(script, n):
    deadline = time.monotonic() + 10
    while len(script.written) < n and time.monotonic() < deadline:
        time.sleep(0.001)
    return script.written


def test_a_lost_link_comes_back_in_a_new_clock_segment_with_the_recipe_and_the_grant(
    run, rtde_script, sink, losses, restored
):
    missed = []
    script = later(rtde_script, output_int_register_24=1)
    first = {"output_int_register_24": 1}
    stream = run(script, first=first, granted=2, on_missed=lambda topic, n: missed.append((topic, n)))
    restored.wait()
    assert wait_for_grant(script, 1) == [2]
    sink.wait_for(lambda: len(sink.samples) == 6)
    assert [sample.segment for sample in sink.samples] == [0, 0, 0, 1, 1, 1]
    assert sink.samples[3].cycle_count == 1
    assert missed == [("/robot/state", 35)]
    texts = [entry.text for entry in sink.logs]
    assert "closed the connection" in texts[0]
    assert any("samples never came" in text for text in texts)
    assert any("is back after" in text for text in texts)
    assert (len(losses.errors), restored.count) == (1, 1)
    stream.grant_cycles(3)
    assert wait_for_grant(script, 2) == [2, 3]


@pytest.mark.parametrize(
    "now", [{"output_int_register_24": 1, "output_int_register_25": 1}, {"output_int_register_24": 2}]
)
def test_a_grant_that_was_used_while_the_link_was_lost_is_not_given_again(run, rtde_script, sink, now):
    script = later(rtde_script, **now)
    run(script, first={"output_int_register_24": 1}, granted=2)
    assert wait_for_grant(script, 1) == [0]
    assert not any("is not the one" in entry.text for entry in sink.logs)


def test_while_the_link_is_lost_no_cycle_can_be_granted(run):
    stream = run()
    with pytest.raises(LinkLostError, match="the link to it is lost"):
        stream.grant_cycles(1)


@pytest.mark.parametrize(
    ("begin_s", "state", "told"),
    [
        (0.5, {"output_int_register_24": 3}, "restarted: its time went from 61.016 s to 0.500 s"),
        (90.0, {"output_int_register_24": 3}, "restarted: its time went from 61.016 s to 90.000 s"),
        (61.304, {"output_int_register_24": 0}, "began anew at controller time 61.304 s: its counter went from 3 to 0"),
        (61.304, {"output_int_register_24": 3, "runtime_state": 1}, "is not the one that was granted 4 cycles"),
        (61.304, {"output_int_register_24": 5}, "is not the one that was granted 4 cycles"),
    ],
    ids=["rebooted", "rebooted long ago", "program restarted", "program stopped", "another program"],
)
def test_a_program_that_is_another_one_after_the_loss_is_granted_nothing(
    run, rtde_script, sink, restored, begin_s, state, told
):
    script = later(rtde_script, begin_s, **state)
    run(script, first={"output_int_register_24": 3}, granted=4)
    restored.wait()
    assert wait_for_grant(script, 1) == [0]
    texts = [entry.text for entry in sink.logs]
    assert any(told in text for text in texts)
    assert any("it gets none" in text for text in texts)
    assert sink.samples[-1].segment == 1


def test_a_withdrawn_grant_stays_withdrawn_over_the_next_loss(run, rtde_script, restored):
    def reboot_and_hang_up(link, names, types):
        link.sendall(samples(names, types, 0.5))
        link.shutdown(2)

    rebooted, later_on = rtde_script(after=reboot_and_hang_up), later(rtde_script, 1.0)
    run(rebooted, later_on, granted=4, first={"output_int_register_24": 3})
    assert wait_for_grant(later_on, 1) == [0]


def test_attempts_go_on_until_the_controller_answers_and_each_reason_is_told_once(run, rtde_script, sink, restored):
    def booting(link):
        link.recv(100)
        link.shutdown(2)

    run(booting, booting, rtde_script(in_use=True), later(rtde_script))
    restored.wait()
    texts = [entry.text for entry in sink.logs if entry.severity == Severity.WARN]
    assert sum("closed the connection when asked" in text for text in texts) == 1
    assert sum("in use by somebody else" in text for text in texts) == 1


def test_each_loss_is_reported_and_each_return(run, rtde_script, sink, losses, restored):
    def brief(link, names, types):
        link.sendall(samples(names, types, 61.304))
        link.shutdown(2)

    run(rtde_script(after=brief), later(rtde_script, 61.6))
    sink.wait_for(lambda: sink.samples[-1].segment == 2)
    assert [sample.segment for sample in sink.samples] == [0, 0, 0, 1, 2, 2, 2]
    restored.wait(2)
    assert len(losses.errors) == 2


def test_a_link_that_does_not_come_back_in_time_is_lost_for_good(run, sink, losses, restored):
    run(reconnect_s=0.3)
    sink.wait_for(lambda: any("did not come back within 0.3 s" in entry.text for entry in sink.logs))
    assert sink.logs[-1].severity == Severity.ERROR
    assert (len(losses.errors), restored.count) == (1, 0)


def test_a_controller_that_answers_but_sends_no_samples_is_not_back(run, rtde_script, sink, restored):
    run(rtde_script(), later(rtde_script), silence_s=0.1)
    restored.wait()
    assert any("sent nothing for 0.1 s" in entry.text and entry.severity == Severity.WARN for entry in sink.logs)


def test_a_controller_that_talks_but_sends_no_samples_is_silent(
    scripted, rtde_script, make_config, clock, sink, losses
):
    text = encode_frame(PackageType.TEXT, encode_text(TextMessage("busy", "", 3)))

    def chatter(link, _names, _types):
        while True:
            link.sendall(text)

    server = scripted(HOST, rtde_script(after=chatter))
    stream = make_state_stream(make_config(HOST, rtde_port=server.port), clock, on_lost=losses)
    stream.open(sink)
    try:
        assert "sent nothing for 1 s" in str(losses.wait())
    finally:
        stream.close()


def test_closing_ends_the_attempts(run, sink):
    stream = run(reconnect_s=3600.0)
    stream.close()
    stream.close()
    assert not any("did not come back" in entry.text for entry in sink.logs)
    with pytest.raises(LinkLostError, match="not open"):
        stream.grant_cycles(1)
