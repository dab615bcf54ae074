"""The configuration of a cycle to look at."""

from __future__ import annotations

from pathlib import Path

import pytest

from bench.config import load_config, parse_config, simulated_config, simulated_config_text
from bench.run import make_slow_cycle

CONFIGS = Path(__file__).parents[2] / "bench_configs"


def test_a_ur_that_waits_for_grants_drives_slowly_into_a_file_of_that_name() -> None:
    slow = make_slow_cycle(simulated_config())
    assert (slow.run.first_cycle_speed, slow.run.name) == (0.25, "simulated-check")


def test_a_speed_that_is_configured_counts() -> None:
    text = simulated_config_text().replace("[run]", "[run]\nfirst_cycle_speed = 0.1")
    assert make_slow_cycle(parse_config(text, "lab.toml")).run.first_cycle_speed == 0.1


@pytest.mark.parametrize("free_running", [True, False])
def test_a_robot_whose_slider_cannot_be_moved_drives_at_its_programs_speed(free_running: bool) -> None:
    if free_running:
        lines = 'source = "digital_output"\ndigital_output = 3'
        config = parse_config(simulated_config_text().replace('source = "counter"', lines), "lab.toml")
    else:
        config = load_config(CONFIGS / "modbus_generic_plc.toml")
    assert make_slow_cycle(config).run.first_cycle_speed == 1.0


def test_the_longest_name_stays_a_name_that_a_run_may_have() -> None:
    text = simulated_config_text().replace('name = "simulated"', f'name = "{"a" * 80}"')
    name = make_slow_cycle(parse_config(text, "lab.toml")).run.name
    assert len(name) == 80
    assert name.endswith("-check")
