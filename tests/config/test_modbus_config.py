"""The Modbus table of a configuration: what is valid, and the sentences for what is not."""

from __future__ import annotations

from pathlib import Path

import pytest

from bench.config import ModbusRobotConfig, RobotConfig, parse_config, simulated_config_text, to_toml
from bench.errors import ConfigError

SIMULATED = (Path(__file__).parents[2] / "bench_configs" / "modbus_simulated.toml").read_text(encoding="utf-8")
COUNTER = 'cycle_counter = { table = "input", address = 1, type = "u16"'
STATE = 'state = { table = "input", address = 0,'


def fault(old: str, new: str, text: str = SIMULATED) -> str:
    assert old in text
    with pytest.raises(ConfigError) as caught:
        parse_config(text.replace(old, new, 1), "plc.toml")
    return str(caught.value)


def test_kind_chooses_the_table() -> None:
    assert isinstance(parse_config(SIMULATED, "x").robot, ModbusRobotConfig)
    assert isinstance(parse_config(simulated_config_text(), "x").robot, RobotConfig)
    without_kind = simulated_config_text().replace('kind = "ur"\n', "")
    assert isinstance(parse_config(without_kind, "x").robot, RobotConfig)


def test_the_resolved_register_map_reads_back_equal() -> None:
    config = parse_config(SIMULATED, "x")
    assert parse_config(to_toml(config), "again") == config


def test_a_typo_in_a_ur_table_is_told_as_ever() -> None:
    message = fault('host = "127.0.0.21"', 'hst = "127.0.0.21"', simulated_config_text())
    assert message.startswith("plc.toml, line 8: robot.host is missing (Address of the controller).")
    assert "plc.toml, line 10: robot.hst is not a known key; did you mean 'host'?" in message
    assert (
        fault("running_register = 25", "runing_register = 25", simulated_config_text())
        == "plc.toml, line 17: robot.cycle.runing_register is not a known key; did you mean 'running_register'?"
    )


def test_an_unknown_kind_names_both() -> None:
    assert fault('kind = "modbus"', 'kind = "kuka"') == (
        "plc.toml, line 11: robot.kind = 'kuka': it must be 'ur' or 'modbus'."
    )


def test_a_typo_deep_in_the_map_has_its_line_and_a_suggestion() -> None:
    message = fault(STATE, STATE.replace("address", "adress"))
    assert "line 24: robot.map.state.adress is not a known key; did you mean 'address'?" in message
    assert "robot.map.state.address is missing (Address in the table" in message


@pytest.mark.parametrize(
    ("old", "new", "sentence"),
    [
        (COUNTER, COUNTER + ", wrap = 70000", "wrap = 70000 is beyond the end of a u16"),
        (COUNTER, COUNTER.replace("u16", "i16") + ", wrap = 40000", "wrap = 40000 is beyond the end of a i16"),
        (
            COUNTER,
            COUNTER.replace("u16", "u32") + ", restarts = false",
            "grant as u16 cannot follow a u32 counter that",
        ),
        ("byte_order", "read_max = 126\nbyte_order", "it must be less than or equal to 125"),
        (STATE, 'state = { table = "coil", address = 0,', "a coil is one bit: its type is 'bool', not 'u16'"),
        (STATE, STATE + " bit = 3,", "bit = 0 to 15 belongs to a bool in a register"),
        (STATE, STATE + " scale = 0.0,", "scale = 0 would make every value the same"),
        ("base = 0", "base = 1", "state: address 0 does not exist, counted from base = 1"),
        ("address = 17,", "address = 65536,", "heartbeat_in: address 65536 does not exist, counted from base = 0"),
        ("stopped = [0]", "stopped = [1]", "value 1 stands for two states"),
        ("stopped = [0]", "stopped = []", "running and stopped need at least one value each"),
        ("waiting = [1], ", "", "map either cycle_running, or a value of state that means waiting"),
        (
            'grant = { table = "holding"',
            'grant = { table = "input"',
            "goes with a coil or a holding register, not with 'input'",
        ),
        (
            'grant = { table = "holding", address = 0, type = "u16" }\n',
            "",
            "map.grant and map.command.start are needed",
        ),
        ("cycle_counter = { ", "cycle_counter = { scale = 2.0, ", "a counter is a u16, u32, i16 or i32 without scale"),
        ("poll_rate_hz = 50", "poll_rate_hz = 500", "less than or equal to 100"),
        (
            'grant = { table = "holding", address = 0, type = "u16"',
            'grant = { table = "holding", address = 0, type = "bool", bit = 2',
            "one bit of a register cannot be written without touching the others",
        ),
    ],
)
def test_a_contradiction_in_the_map_is_one_sentence(old: str, new: str, sentence: str) -> None:
    message = fault(old, new)
    assert sentence in message
    assert message.count("\n") == 0


def test_a_pulsed_start_needs_a_stop() -> None:
    line = next(line for line in SIMULATED.splitlines(keepends=True) if line.startswith("stop = "))
    assert "map.command.stop is needed" in fault(line, "")
    level = SIMULATED.replace(line, "").replace('start = { table = "coil"', 'start = { hold = "level", table = "coil"')
    assert parse_config(level, "x").robot is not None


def test_what_is_only_observed_needs_nothing_to_write() -> None:
    text = SIMULATED.replace("unit_id = 1", "unit_id = 1\nobserve_only = true")
    cut = "".join(
        line for line in text.splitlines(keepends=True) if not line.startswith(("grant", "start =", "stop ="))
    )
    assert parse_config(cut, "x").robot is not None
