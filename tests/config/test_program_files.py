"""The copy of the robot's program: read beside the configuration, or refused in one sentence."""

from __future__ import annotations

import hashlib
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from bench.cli import main
from bench.config import LARGEST_PROGRAM, ProgramFile, load_config, read_program_file, simulated_config_text
from bench.errors import ConfigError

PACKED = bytes.fromhex("1f8b0800") + bytes(range(256))
MODBUS = Path(__file__).parents[2] / "bench_configs" / "modbus_generic_plc.toml"


def write_config(folder: Path, name: str) -> Path:
    path = folder / "lab.toml"
    text = simulated_config_text().replace("[robot]\n", f"[robot]\nprogram_file = '{name}'\n")
    path.write_text(text, encoding="utf-8")
    return path


def read(path: Path) -> ProgramFile | None:
    return read_program_file(load_config(path), path.parent)


def test_the_copy_is_found_beside_the_configuration_wherever_bench_is_called(tmp_path: Path) -> None:
    (tmp_path / "robot").mkdir()
    (tmp_path / "robot" / "bend v3.urp").write_bytes(PACKED)
    program = read(write_config(tmp_path, "robot/bend v3.urp"))
    assert program is not None
    assert program.to_metadata() == {
        "file": "bend v3.urp",
        "sha256": hashlib.sha256(PACKED).hexdigest(),
        "bytes": str(len(PACKED)),
        "attachment": "program.urp",
    }
    assert program.content == PACKED


def test_a_modbus_robot_has_a_copy_in_the_same_way(tmp_path: Path) -> None:
    text = MODBUS.read_text(encoding="utf-8").replace(
        'kind = "modbus"\n', 'kind = "modbus"\nprogram_file = "st.zip"\n', 1
    )
    (tmp_path / "plc.toml").write_text(text, encoding="utf-8")
    (tmp_path / "st.zip").write_bytes(b"PK")
    program = read(tmp_path / "plc.toml")
    assert program is not None
    assert (program.name, program.content) == ("st.zip", b"PK")


def test_without_the_key_there_is_no_copy(tmp_path: Path) -> None:
    assert read(write_config(tmp_path, "")) is None


@pytest.mark.parametrize(
    ("name", "reason"),
    [
        ("gone.urp", r"gone\.urp cannot be read: No such file"),
        (".", "cannot be read: Is a directory"),
        ("empty.urp", r"empty\.urp is empty"),
        ("huge.urp", r"huge\.urp has more than the 16 MB"),
        ("x" * 300, "cannot be read: File name too long"),
    ],
)
def test_a_copy_that_cannot_travel_is_refused_with_the_reason(tmp_path: Path, name: str, reason: str) -> None:
    (tmp_path / "empty.urp").touch()
    with (tmp_path / "huge.urp").open("wb") as file:
        file.truncate(LARGEST_PROGRAM + 1)
    with pytest.raises(ConfigError, match=reason) as caught:
        read(write_config(tmp_path, name))
    assert caught.value.exit_code == 2
    assert "program_file" in caught.value.hint


def test_the_largest_copy_is_taken(tmp_path: Path) -> None:
    with (tmp_path / "large.urp").open("wb") as file:
        file.truncate(LARGEST_PROGRAM)
    program = read(write_config(tmp_path, "large.urp"))
    assert program is not None
    assert len(program.content) == LARGEST_PROGRAM


@pytest.mark.parametrize("command", ["config check", "check", "run --cycles 1", "run --cycles 1 --dry-run"])
def test_every_command_that_needs_the_bench_refuses_before_it_touches_anything(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], command: str
) -> None:
    config = write_config(tmp_path, "gone.urp")
    monkeypatch.setattr("sys.argv", ["bench", *command.split(), str(config)])
    monkeypatch.chdir(tmp_path)
    with pytest.raises(SystemExit) as ended:
        main()
    assert ended.value.code == 2
    assert "gone.urp cannot be read: No such file" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == [config]


@given(st.text(min_size=1, max_size=40))
def test_no_file_name_makes_an_attachment_that_leads_anywhere(name: str) -> None:
    attachment = ProgramFile(name, b"x").attachment
    assert attachment.startswith("program")
    assert attachment.removeprefix("program.").isalnum()
    assert attachment not in {"config.toml", "calibration.toml"}
