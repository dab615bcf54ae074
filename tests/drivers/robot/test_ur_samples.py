from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest

from bench.config import CycleConfig
from bench.drivers.robot.ur.codec import NAME_LIST_LIMIT, PackageType, TextMessage, encode_text
from bench.drivers.robot.ur.fields import essential_outputs, wanted_outputs
from bench.drivers.robot.ur.handshake import Session, delivered_rate_hz
from bench.drivers.robot.ur.recipe import Recipe
from bench.drivers.robot.ur.samples import SampleReader
from bench.errors import ProtocolError
from bench.model import NO_BITS, LogEntry, RobotState, Severity
from bench.simulation.ur.variables import OUTPUT_TYPES, initial_values
from bench.timing import ManualClock

CYCLE = CycleConfig()
PERIOD_NS = 2_000_000


class Stream:
    """A reader fed with packages that differ in what the test says."""

    def __init__(self, unknown=(), cycle=CYCLE, left_out=()):
        names = wanted_outputs(cycle, frozenset(unknown))
        self.recipe = Recipe(names, [OUTPUT_TYPES[name] for name in names], 1)
        inputs = Recipe(["input_int_register_24"], ["INT32"], 1)
        self.records, self.missed = [], []
        self.reader = SampleReader(
            Session((5, 15, 0, 0), 500.0, self.recipe, inputs, tuple(left_out)),
            cycle,
            ManualClock(),
            self.records.append,
            lambda topic, n: self.missed.append((topic, n)),
            peer="controller 127.0.31.9:30004",
        )

    def take(self, time_s, arrival_ns=0, **values):
        state = initial_values() | {"timestamp": time_s} | values
        payload = self.recipe.encode([state[name] for name in self.recipe.names])
        self.reader.take(arrival_ns, [(PackageType.DATA, payload)])

    @property
    def samples(self):
        return [record for record in self.records if isinstance(record, RobotState)]

    @property
    def logs(self):
        return [record for record in self.records if isinstance(record, LogEntry)]


def test_every_field_of_a_sample_comes_from_its_own_output():
    stream = Stream(cycle=CycleConfig(phase_register=26))
    names = ["actual_q", "actual_qd", "target_q", "actual_current", "joint_temperatures"]
    names += ["actual_TCP_pose", "actual_TCP_speed", "actual_TCP_force", "target_qd", "tcp_offset"]
    vectors = {name: tuple(float(10 * place + axis) for axis in range(6)) for place, name in enumerate(names)}
    numbers = {
        "speed_scaling": 0.9,
        "target_speed_fraction": 0.8,
        "runtime_state": 2,
        "robot_mode": 7,
        "safety_status": 3,
        "actual_digital_input_bits": 5,
        "actual_digital_output_bits": 2**40,
        "output_int_register_24": 11,
        "output_int_register_25": 1,
        "output_double_register_26": 0.25,
        "safety_status_bits": 1028,
        "robot_status_bits": 3,
        "payload": 1.5,
        "payload_cog": (0.0, 0.01, 0.05),
        "script_control_line": 12,
        "time_scale_source": 4,
        "collision_detection_ratio": 0.2,
        "joint_position_deviation_ratio": 0.3,
        "actual_main_voltage": 48.1,
        "actual_robot_current": 1.1,
        "control_step": 2**40,
    }
    stream.take(61.25, 77, **vectors, **numbers)
    (sample,) = stream.samples
    assert (sample.arrival_ns, sample.capture_ns, sample.sequence, sample.segment) == (77, 77, 30625, 0)
    fields = ["q_rad", "qd_rad_s", "target_q_rad", "current_a", "joint_temperature_c"]
    fields += ["tcp_pose", "tcp_speed", "tcp_force", "target_qd_rad_s", "tcp_offset"]
    assert [getattr(sample, field) for field in fields] == list(vectors.values())
    fields = ["speed_scaling", "speed_fraction", "runtime_state", "robot_mode", "safety_status"]
    fields += ["digital_inputs", "digital_outputs", "cycle_count", "cycle_running", "cycle_phase"]
    fields += ["safety_status_bits", "robot_status_bits", "payload_kg", "payload_cog_m", "script_control_line"]
    fields += ["time_scale_source", "collision_detection_ratio", "joint_position_deviation_ratio"]
    fields += ["main_voltage_v", "robot_current_a", "control_step"]
    assert [getattr(sample, field) for field in fields] == list(numbers.values())


def test_an_old_controller_gives_its_safety_mode_and_nothing_for_what_it_lacks():
    lacking = ["safety_status", "actual_TCP_force", "target_speed_fraction", "actual_digital_output_bits"]
    stream = Stream(unknown=[*lacking, "runtime_state"], left_out=lacking)
    stream.take(61.25, safety_mode=5)
    (sample,) = stream.samples
    assert sample.safety_status == 5
    assert all(math.isnan(number) for number in (*sample.tcp_force, sample.speed_fraction, sample.cycle_phase))
    assert (sample.runtime_state, sample.digital_outputs, sample.cycle_count) == (-1, NO_BITS, 0)
    assert "safety_status, actual_TCP_force" in stream.logs[0].text


def test_what_a_controller_lacks_is_never_zero():
    lacking = frozenset(OUTPUT_TYPES) - essential_outputs(CYCLE)
    stream = Stream(unknown=lacking)
    stream.take(61.25)
    (sample,) = stream.samples
    given = {"arrival_ns", "capture_ns", "sequence", "segment", "controller_time_s", "cycle_count", "cycle_running"}
    for field in dataclasses.fields(RobotState):
        if field.name not in given:
            value = getattr(sample, field.name)
            assert repr(value) == repr(field.default)
            assert value in (-1, NO_BITS) or all(math.isnan(number) for number in np.atleast_1d(value))


def test_the_registers_are_those_for_external_clients_by_default():
    names = wanted_outputs(CycleConfig(), frozenset())
    registers = [int(name.rsplit("_", 1)[1]) for name in names if "register" in name]
    assert registers
    assert all(24 <= register <= 47 for register in [*registers, CycleConfig().grant_register])


def test_the_names_that_are_asked_for_fit_into_one_setup():
    longest = CycleConfig(register=46, running_register=47, phase_register=47)
    assert len(",".join(wanted_outputs(longest, frozenset()))) <= NAME_LIST_LIMIT


def test_skipped_samples_are_counted_from_the_time_grid_and_told():
    stream = Stream()
    for tick in (100, 101, 104, 105, 110):
        stream.take(tick / 500, tick * PERIOD_NS)
    stream.reader.finish()
    assert stream.missed == [("/robot/state", 2), ("/robot/state", 4)]
    assert [entry.text.split()[0] for entry in stream.logs] == ["2", "4"]
    assert {sample.segment for sample in stream.samples} == {0}


def test_a_controller_that_skips_all_the_time_writes_one_sentence_a_second():
    stream = Stream()
    for tick in range(0, 4000, 2):
        stream.take(tick / 500, tick * PERIOD_NS)
    stream.reader.finish()
    assert sum(n for _, n in stream.missed) == 1999
    assert sum(int(entry.text.split()[0]) for entry in stream.logs) == 1999
    assert len(stream.logs) <= 10


def test_a_restarted_controller_begins_a_new_clock_segment():
    stream = Stream()
    stream.take(100.0, 10**12)
    stream.take(0.002, 10**12 + PERIOD_NS)
    stream.take(0.004, 10**12 + 2 * PERIOD_NS)
    assert [sample.segment for sample in stream.samples] == [0, 1, 1]
    assert [sample.capture_ns for sample in stream.samples][1:] == [10**12 + PERIOD_NS, 10**12 + 2 * PERIOD_NS]
    assert "restarted" in stream.logs[0].text
    assert not stream.missed


def test_a_sample_that_comes_twice_is_kept_and_is_no_gap():
    stream = Stream()
    for tick in (5, 5, 6):
        stream.take(tick / 500)
    assert (len(stream.samples), stream.missed, stream.logs) == (3, [], [])


def test_the_delay_of_a_burst_does_not_bend_capture_times():
    stream = Stream()
    for tick in range(1, 51):
        late_ns = 40_000_000 - tick * PERIOD_NS if 10 < tick <= 20 else 0
        stream.take(tick / 500, tick * PERIOD_NS + late_ns)
    assert [sample.capture_ns for sample in stream.samples] == [tick * PERIOD_NS for tick in range(1, 51)]


@pytest.mark.parametrize(("level", "severity"), [(0, 40), (1, 40), (2, 30), (3, 20), (9, 20)])
def test_texts_of_the_controller_become_log_entries(level, severity):
    stream = Stream()
    stream.reader.take(0, [(PackageType.TEXT, encode_text(TextMessage("joint hot", "J3", level)))])
    assert stream.logs[0].severity == Severity(severity)
    assert stream.logs[0].text.endswith("says: J3: joint hot")


def test_an_unreadable_text_ends_nothing():
    stream = Stream()
    stream.reader.take(0, [(PackageType.TEXT, b"\xff\x00")])
    assert "unreadable text ff00" in stream.logs[0].text


@pytest.mark.parametrize("time_s", [math.nan, math.inf, 1e300, -0.002])
def test_a_time_that_is_none_is_refused(time_s):
    with pytest.raises(ProtocolError, match="controller time"):
        Stream().take(time_s)


def test_a_vector_where_a_number_is_due_is_refused():
    recipe = Recipe(["timestamp", "actual_q"], ["DOUBLE", "DOUBLE"], 1)
    with pytest.raises(ProtocolError, match="gives 'actual_q' as 1 numbers where 6 are due"):
        SampleReader(Session((5, 15, 0, 0), 500.0, recipe, recipe, ()), CYCLE, ManualClock(), lambda record: None)


def test_a_real_number_where_a_whole_one_is_due_is_refused():
    recipe = Recipe(["timestamp", "robot_mode"], ["DOUBLE", "DOUBLE"], 1)
    with pytest.raises(ProtocolError, match="gives 'robot_mode' as a real number where a whole one is due"):
        SampleReader(Session((5, 15, 0, 0), 500.0, recipe, recipe, ()), CYCLE, ManualClock(), lambda record: None)


@pytest.mark.parametrize(
    ("wanted", "major", "delivered"),
    [(500, 5, 500), (125, 5, 125), (100, 5, 100), (300, 5, 250), (1, 5, 1), (500, 3, 125), (60, 3, 62.5)],
)
def test_the_rate_asked_for_divides_the_rate_of_the_controller(wanted, major, delivered):
    assert delivered_rate_hz(wanted, major) == delivered
