"""Configurations: strict reading, sentences with line and key, resolved output."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bench.config import config_schema, load_config, parse_config, simulated_config, simulated_config_text, to_toml
from bench.errors import ConfigError

TAKE = """\
[cable]
length_m = 1.2
diameter_mm = 8.0
marker_arc_length_m = [0.1, 0.2, 0.3, 0.4]
minimum_bend_radius_mm = 60.0

[cable.anchor]
kind = "static_marker"
"""


def fault(text: str) -> str:
    with pytest.raises(ConfigError) as caught:
        parse_config(text, "lab.toml")
    assert caught.value.exit_code == 2
    return str(caught.value)


def test_a_configuration_for_a_take_needs_only_the_cable() -> None:
    config = parse_config(TAKE, "take.toml")
    assert config.robot is None
    assert config.cable.arc_length_m == (0.1, 0.2, 0.3, 0.4)


def test_the_resolved_configuration_reads_back_equal() -> None:
    config = simulated_config()
    assert parse_config(to_toml(config), "again.toml") == config


def test_an_unknown_key_is_named_with_its_line_and_its_likely_meaning() -> None:
    text = TAKE.replace("diameter_mm = 8.0", "diameter_mm = 8.0\nstrech = 0.1")
    assert fault(text) == "lab.toml, line 4: cable.strech is not a known key; did you mean 'stretch'?"


def test_a_key_in_another_unit_is_told_to_be_a_unit() -> None:
    text = TAKE.replace("length_m = 1.2", "length_mm = 1200.0", 1)
    message = fault(text)
    assert (
        "line 2: cable.length_mm is not a known key; the unit is part of the key: did you mean 'length_m'?" in message
    )
    assert "cable.length_m is missing (Length between the two clamps)" in message


def test_a_number_in_quotes_is_refused() -> None:
    assert "line 3: cable.diameter_mm = '8'" in fault(TAKE.replace("8.0", '"8"'))


def test_a_length_that_can_only_be_millimetres_is_refused() -> None:
    assert "cable.length_m = 1200" in fault(TAKE.replace("length_m = 1.2", "length_m = 1200", 1))


def test_every_fault_is_reported_at_once() -> None:
    message = fault(TAKE.replace("8.0", "-8.0").replace("60.0", "0.0") + "[foo]\na = 1\n")
    assert message.count("lab.toml, line") == 3


def test_an_unknown_kind_lists_what_is_known() -> None:
    message = fault(TAKE.replace("static_marker", "statik"))
    assert "cable.anchor.kind = 'statik'" in message
    assert "'rigid_body'" in message


@pytest.mark.parametrize(
    ("old", "new", "sentence"),
    [
        ("[0.1, 0.2, 0.3, 0.4]", "[0.1, 0.3, 0.2]", "must ascend"),
        ("[0.1, 0.2, 0.3, 0.4]", "[0.1, 0.2, 1.3]", "beyond the cable's length_m"),
        ("[0.1, 0.2, 0.3, 0.4]", "[0.1]", "at least 2"),
        ('kind = "static_marker"', 'kind = "rigid_body"', "needs name"),
        ('kind = "static_marker"', 'kind = "static_marker"\nname = "pole"', "belongs to kind = 'rigid_body'"),
        ("minimum_bend", "max_tension_n = 3.0\nminimum_bend", "belong together"),
        ("marker_arc_length_m = [0.1, 0.2, 0.3, 0.4]", "marker_count = 3", "either marker_arc_length_m"),
    ],
)
def test_a_contradiction_is_one_sentence(old: str, new: str, sentence: str) -> None:
    assert sentence in fault(TAKE.replace(old, new))


def test_text_that_is_no_toml_names_the_line() -> None:
    assert "lab.toml, line 1 is not valid TOML: [cable (" in fault("[cable\nlength_m = 1")


@pytest.mark.parametrize(
    ("line", "advice"),
    [
        ("diameter_mm = 8,0", "Write a decimal point, not a comma."),
        ("diameter_mm = 8.0 mm  # outside", "Write the number alone: its unit is part of the key."),
        ("host = 192.168.0.10", 'Put an address in quotes: "192.168.0.10".'),
        ("kind = ur", 'Put text in quotes: "text"; true and false stand without.'),
        ("name = “seven”", 'Use straight quotes: "text".'),
        ('name = "seven', "The quote at the end of the text is missing."),
        ('output_dir = "C:\\Users\\lab"', "In a path write / instead of \\, or put it in single quotes."),
        ("length_m =", "The value is missing."),
        ("length_m 1.2", "Write: key = value."),
        ("[cable", "The bracket ] at the end is missing."),
        ("places = [0.1, 0.2\nlength_m = 1.2", "The list before this line has no ] at its end."),
        ("[cable]\n[cable]", "[cable] ([cable] stands twice)."),
        ("a = 1\na = 2", "this key stands twice in its table"),
    ],
)
def test_a_line_that_is_no_toml_is_shown_with_what_to_write_instead(line: str, advice: str) -> None:
    message = fault(line)
    assert "is not valid TOML: " in message
    assert advice in message
    assert re.match(r"lab\.toml, line [12] ", message)


def test_a_text_that_is_never_closed_is_said_where_the_file_ends() -> None:
    assert "line 3 is not" in fault('a = """b\nc\nd\n')
    assert fault('a = """b\nc\nd\n').endswith("A bracket or a quote that was opened is not closed.")


def test_a_value_out_of_its_range_says_what_the_key_means() -> None:
    message = fault(TAKE.replace("minimum_bend", "shorten = 25\nminimum_bend"))
    assert "cable.shorten = 25: it must be less than 1 (" in message
    assert "how much a chord may shorten" in message


def test_a_name_with_a_blank_or_a_slash_says_what_may_stand_in_it() -> None:
    assert "only letters, digits, '.', '_' and '-' can stand in it" in fault(f'{TAKE}\n[run]\nname = "a b/7"\n')


def test_the_mark_before_the_text_that_editors_on_windows_leave_is_read_over(tmp_path: Path) -> None:
    (tmp_path / "lab.toml").write_bytes(b"\xef\xbb\xbf" + TAKE.encode())
    assert load_config(tmp_path / "lab.toml") == parse_config(TAKE, "x")


def test_a_recording_given_as_configuration_is_called_one(tmp_path: Path) -> None:
    (tmp_path / "run.mcap").write_bytes(b"\x89MCAP0\r\n\xff")
    with pytest.raises(ConfigError, match=r"It is a recording: `bench report` and `bench info` take it\."):
        load_config(tmp_path / "run.mcap")


def test_a_file_that_cannot_be_read_is_a_config_error(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="cannot be read"):
        load_config(tmp_path / "missing.toml")
    (tmp_path / "binary.toml").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(ConfigError, match="not UTF-8"):
        load_config(tmp_path / "binary.toml")


def test_hookes_law_gives_the_stretch() -> None:
    text = TAKE.replace("minimum_bend", "axial_stiffness_n = 2000.0\nmax_tension_n = 50.0\nminimum_bend")
    assert parse_config(text, "x").cable.stretch_ratio == pytest.approx(0.025)


def test_even_spacing_may_be_given_by_count_and_spacing() -> None:
    text = TAKE.replace("marker_arc_length_m = [0.1, 0.2, 0.3, 0.4]", "marker_count = 3\nmarker_spacing_m = 0.25")
    assert parse_config(text, "x").cable.arc_length_m == pytest.approx((0.25, 0.5, 0.75))


def test_the_schema_describes_every_table() -> None:
    assert set(config_schema()["properties"]) == {
        "run",
        "robot",
        "tracker",
        "cable",
        "calibration",
        "analysis",
        "policy",
        "simulation",
    }


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 60), st.sampled_from(["\n", "=", "[", '"', "x", "7", "\x00", "é"]))
def test_a_damaged_file_is_read_or_refused_but_never_crashes(line: int, inserted: str) -> None:
    lines = simulated_config_text().splitlines()
    lines.insert(min(line, len(lines)), inserted)
    try:
        parse_config("\n".join(lines), "damaged.toml")
    except ConfigError as error:
        assert "damaged.toml" in str(error)


OUTPUT_3 = 'source = "digital_output"\ndigital_output = 3\n'


def with_cycle(keys: str) -> str:
    """Return the simulated bench's configuration with another ``[robot.cycle]``."""
    before, _, after = simulated_config_text().partition("[robot.cycle]")
    return f"{before}[robot.cycle]\n{keys}\n[{after.partition('[')[2]}"


@pytest.mark.parametrize(
    ("keys", "fault"),
    [
        ('source = "digital_output"', "needs digital_output = N"),
        ("digital_output = 3", "belongs to source = 'digital_output'"),
        ('source = "joint_return"\ndigital_output_mode = "pulse"', "belongs to source = 'digital_output'"),
        ("joint_tolerance_deg = 1.0", "belongs to source = 'joint_return'"),
        (f'{OUTPUT_3}digital_output_mode = "pulse"\ngrant = true', "grant = true"),
        ("grant = false", "a program that counts waits for its grant"),
    ],
)
def test_a_key_of_another_cycle_source_is_refused_rather_than_ignored(keys: str, fault: str) -> None:
    with pytest.raises(ConfigError, match=fault):
        parse_config(with_cycle(keys), "bench.toml")


def test_only_a_program_that_counts_is_granted_its_cycles_unless_it_says_so() -> None:
    keys = 'source = "joint_return"\nstart_joints_deg = [0, -90, 90, 0, 90, 0]\n'
    for more, granted in (("", False), ("grant = true\n", True)):
        config = parse_config(with_cycle(keys + more), "bench.toml")
        assert config.robot is not None
        assert config.robot.cycle.is_granted is granted
        assert parse_config(to_toml(config), "again") == config
    robot = simulated_config().robot
    assert robot is not None
    assert robot.cycle.is_granted


def test_a_recording_is_split_into_parts_of_a_size_or_not_at_all() -> None:
    assert parse_config("[run]\nsplit_mb = 4000\n" + TAKE, "lab.toml").run.split_bytes == 4_000_000_000
    assert parse_config(TAKE, "lab.toml").run.split_bytes == 0
    assert "a part has 1 MB at least; 0: the recording is not split" in fault("[run]\nsplit_mb = 0.5\n" + TAKE)
