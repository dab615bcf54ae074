"""A run on a simulated PLC with a person at its panel: what the user sees, what the file holds, and --resume."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import pytest
from bench_command import bench, start_bench
from fault_bench import ADMIN_PORT, FaultBench

from bench.recording import Run, open_run

MAP = Path(__file__).parents[2] / "bench_configs" / "modbus_simulated.toml"
N_CYCLES = 18
CHANGES = (
    ("127.0.0.61", "127.0.64.71"),
    ("127.0.0.62", "127.0.64.72"),
    ("cycle_s = 2.0", f"cycle_s = 1.0\nadmin_port = {ADMIN_PORT}"),
    # of ours the controller would be satisfied for 20 s: how it pauses without is tested at the driver
    ("period_s = 0.5", "period_s = 5.0"),
    ("max_age_s = 2.0", "max_age_s = 1.0"),
    ("poll_rate_hz = 50", "poll_rate_hz = 25"),
)


class PlcBench(FaultBench):
    """The same with a PLC in place of the UR."""

    def __init__(self, folder: Path) -> None:
        self.run_file = folder / "a.mcap"
        self._host = "127.0.64.71"
        text = MAP.read_text(encoding="utf-8")
        for old, new in CHANGES:
            assert old in text, old
            text = text.replace(old, new)
        config = folder / "plc.toml"
        config.write_text(text, encoding="utf-8")
        self._process = start_bench("run", config, "--cycles", str(N_CYCLES), "--speed", "4", "--output", self.run_file)


@dataclass(frozen=True)
class Night:
    """A run that met what it can survive, was ended by what it cannot, and was gone on with."""

    code: int
    out: str
    err: str
    run: Run
    rest: Run
    rest_out: str
    stopped_in: list[int]
    """Cycles in which the robot was stopped."""


@pytest.fixture(scope="module")
def night(tmp_path_factory: pytest.TempPathFactory) -> Night:
    folder = tmp_path_factory.mktemp("plc-night")
    plc = PlcBench(folder)
    try:
        plc.wait("the first cycle", lambda: plc.n_completed() > 0)
        stopped_in = [
            plc.hold_and_go_on("open_interlock guard door", lambda: plc.admin("close_interlock guard door")),
            plc.hold_and_go_on("pause", lambda: plc.admin("resume")),
        ]
        plc.hold_and_go_on("heartbeat off", lambda: plc.admin("heartbeat on"))
        plc.hold_and_go_on("exception 6", lambda: plc.admin("exception 0"))
        plc.hold_and_go_on("late 2", lambda: plc.admin("late 0"))
        plc.hold_and_go_on("frozen on", lambda: plc.admin("frozen off"))
        plc.admin("fin")
        plc.wait_for_cycle()
        plc.kill_simulator()
        code, out, err = plc.finish()
    finally:
        plc.close()
    rest = bench(
        "run", "--cycles", str(N_CYCLES), "--speed", "4", "--resume", plc.run_file, "--output", folder / "b.mcap"
    )
    assert rest.returncode == 0, rest.stderr + rest.stdout
    return Night(code, out, err, open_run(plc.run_file), open_run(folder / "b.mcap"), rest.stdout, stopped_in)


def completed(run: Run) -> list[int]:
    events = run["/cycle/event"]
    return events.cycle_index[events.kind == 2].tolist()


def test_a_controller_that_is_killed_ends_the_run_and_resume_completes_every_cycle_once(night: Night) -> None:
    assert night.code == 3, night.err + night.out
    assert "The simulated bench has ended" in night.err
    assert "--resume" in night.err
    assert completed(night.run)
    assert completed(night.run) + completed(night.rest) == list(range(N_CYCLES))
    assert f"{N_CYCLES} of {N_CYCLES} cycles completed" in night.rest_out


def test_the_screen_speaks_of_controller_and_interlock_never_of_a_pendant(night: Night) -> None:
    for words in (
        "The interlock 'guard door' opened in cycle",
        "Put it in order; if the program stays paused, resume it at the controller.",
        "Resume it at the controller, or press Ctrl-C twice",
        "The heartbeat of the Modbus controller 127.0.64.71:5020 has not changed for 1 s",
        "exception 6, device busy",
        "It goes on when it is heard again",
    ):
        assert words in night.out, words
    assert "pendant" not in night.out + night.err
    assert "Traceback" not in night.err


def test_every_hold_and_its_reason_is_in_the_file(night: Night) -> None:
    states = night.run["/run/state"]
    reasons = [str(r) for s, r in zip(states.state, states.reason, strict=True) if s == "HOLDING"]
    for words in ("'guard door' opened", "was paused", "heartbeat", "exception 6", "did not answer within 0.8 s"):
        assert any(words in reason for reason in reasons), words
    said = "\n".join(str(text) for text in night.run["/log"].text)
    assert said.count("Over: robot link lost.") >= 4
    assert "shows the interlock 'guard door' open." in said


def test_the_open_interlock_is_a_bit_of_every_state(night: Night) -> None:
    assert {int(bits) for bits in night.run["/robot/state"].digital_inputs} == {0, 1}


def test_cycles_in_which_the_robot_was_stopped_are_marked_and_no_others(night: Night) -> None:
    # on a busy machine a stop may fall between two cycles, where there is none to mark
    events = night.run["/cycle/event"]
    marked = events.cycle_index[events.kind == 3].tolist()
    assert set(marked) <= {*night.stopped_in, completed(night.run)[-1] + 1}
    assert set(marked) & set(night.stopped_in)
