from __future__ import annotations

import sys
import threading

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bench.drivers.robot.ur import dashboard_line
from bench.drivers.robot.ur.effect import EffectLimits
from bench.drivers.robot.ur.program import UrDashboardProgram
from bench.errors import DeviceError

HOST = "127.0.63.6"
PROGRAM = "bend_test.urp"
BANNER = b"Connected: Universal Robots Dashboard Server"
SAID = {
    b"polyscopeversion": b"URSoftware 5.15.0.126652 (Aug 30 2023)",
    b"is in remote control": b"true",
    b"safetystatus": b"Safetystatus: NORMAL",
    b"safetymode": b"Safetymode: NORMAL",
    b"robotmode": b"Robotmode: RUNNING",
    b"programstate": b"STOPPED bend_test.urp",
    b"get loaded program": b"Loaded program: /programs/bend_test.urp",
    b"load bend_test.urp": b"Loading program: bend_test.urp",
    b"play": b"Starting program",
    b"stop": b"Stopped",
}
LINES = st.one_of(
    st.sampled_from([*SAID.values(), b"", b":", b"File not found: x", b"Failed to execute: play"]),
    st.binary(max_size=60),
    st.just(b"x" * 5000),
)


@pytest.mark.parametrize("banner", [b"", BANNER + b"\n"], ids=["the banner drips", "the answer drips"])
def test_an_answer_that_drips_does_not_outlast_the_limit(scripted, clock, monkeypatch, banner):
    monkeypatch.setattr(dashboard_line, "ANSWER_LIMIT_S", 0.2)

    def drip(link):
        link.sendall(banner)
        while True:
            link.sendall(b"x")
            threading.Event().wait(0.02)

    scripted(HOST, drip, port=29999)
    dashboard = dashboard_line.LineDashboard(HOST, clock)
    try:
        with pytest.raises((TimeoutError, RuntimeError), match=r"Operation canceled|timed out"):
            dashboard.connect()
            dashboard.robotmode()
    finally:
        dashboard.disconnect()


class Dashboard:
    """A dashboard that answers as a table says, whatever that is."""

    def __init__(self):
        self.banner = BANNER
        self.replies = SAID

    def __call__(self, link):
        link.sendall(self.banner + b"\n")
        with link.makefile("rb") as lines:
            for line in lines:
                reply = self.replies.get(line.strip().lower())
                if reply is None:
                    link.shutdown(2)
                    return
                link.sendall(reply + b"\n")
        link.shutdown(2)


@pytest.mark.parametrize("client", ["ur_rtde", "own socket"])
def test_whatever_a_dashboard_answers_is_an_error_of_ours_and_in_time(
    scripted, make_config, clock, monkeypatch, client
):
    if client == "ur_rtde":
        pytest.importorskip("dashboard_client", reason="ur_rtde has no build for this Python")
    else:
        monkeypatch.setitem(sys.modules, "dashboard_client", None)
    dashboard = Dashboard()
    scripted(HOST, *[dashboard] * 100_000, port=29999)
    program = UrDashboardProgram(make_config(HOST), clock, EffectLimits(0.0, 0.0))
    calls = (program.play, program.stop, lambda: program.check(PROGRAM), lambda: program.load(PROGRAM))

    def attempt(call):
        try:
            call()
        except DeviceError as error:
            assert str(error).isprintable()

    @settings(max_examples=40, deadline=None)
    @given(st.just(BANNER) | LINES, st.dictionaries(st.sampled_from(sorted(SAID)), LINES))
    def fuzz(banner, replies):
        dashboard.banner, dashboard.replies = banner, SAID | replies
        attempt(program.open)
        for call in calls:
            attempt(call)
        program.close()

    try:
        fuzz()
    finally:
        program.close()
