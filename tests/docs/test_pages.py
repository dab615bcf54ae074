"""Links lead somewhere, made pages are current, and the references name what there is."""

from __future__ import annotations

import json
import tomllib
from pathlib import Path
from typing import Any

import pyarrow.parquet as pq
import pytest
import typer
from markdown_pages import CONFIGS, ROOT, find_anchors, find_links, find_pages
from reference_pages import PAGES as MADE_PAGES
from reference_pages import REFERENCE

from bench import errors
from bench.cli.app import app
from bench.config import load_config, simulated_config_text
from bench.recording import open_run


@pytest.mark.parametrize("page", find_pages(), ids=lambda page: str(page.relative_to(ROOT)))
def test_every_link_of_the_page_leads_somewhere(page: Path) -> None:
    for link in find_links(page):
        if link.startswith(("https://", "http://")):
            continue
        name, _, anchor = link.partition("#")
        target = (page.parent / name).resolve() if name else page
        assert target.exists(), f"{page.name} links to {link}, which does not exist"
        if anchor:
            assert anchor in find_anchors(target), f"{page.name} links to {link}; there is no such heading"


def test_every_page_can_be_reached_from_the_readme() -> None:
    reached: set[Path] = set()
    waiting = [ROOT / "README.md"]
    while waiting:
        page = waiting.pop()
        if page in reached:
            continue
        reached.add(page)
        links = [link.partition("#")[0] for link in find_links(page) if "://" not in link]
        waiting += [(page.parent / link).resolve() for link in links if link.endswith(".md")]
    assert set(find_pages()) - reached == set()


@pytest.mark.parametrize("path", MADE_PAGES, ids=lambda path: path.name)
def test_a_page_made_from_the_code_is_current(path: Path) -> None:
    current = path.read_text(encoding="utf-8") == MADE_PAGES[path]()
    assert current, f"{path.name} is not current: python tests/docs/reference_pages.py"


def test_the_reference_names_every_command_and_option() -> None:
    text = (REFERENCE / "commands.md").read_text(encoding="utf-8")
    for name, command in _commands("bench", typer.main.get_command(app)):
        assert f"`{name}" in text, name
        options = [o for p in command.params if not getattr(p, "hidden", False) for o in p.opts if o.startswith("--")]
        assert [option for option in options if option != "--help" and option not in text] == []


def test_the_reference_names_every_error_with_its_code() -> None:
    rows = (REFERENCE / "errors-and-exit-codes.md").read_text(encoding="utf-8").splitlines()
    code = None
    listed: dict[str, int] = {}
    for row in rows:
        cells = [cell.strip() for cell in row.split("|")]
        if len(cells) == 5 and cells[3].startswith("`"):
            code = int(cells[1]) if cells[1].isdigit() else code
            listed[cells[3].strip("`")] = code or 0
    real = {name: getattr(errors, name).exit_code for name in errors.__all__ if name != "BenchError"}
    assert listed == real


def test_the_reference_names_every_column_of_every_table(material: Path) -> None:
    text = (REFERENCE / "results.md").read_text(encoding="utf-8")
    for path in sorted((material / "run").glob("*.parquet")):
        section = text.partition(f"## {path.name}\n")[2].partition("\n## ")[0]
        columns = pq.read_schema(path).names
        missing = [name for name in columns if f"`{name}`" not in section and f"`{name}`" not in text]
        assert section
        assert missing == [], path.name


def test_the_reference_names_every_key_of_the_summary(material: Path) -> None:
    text = (REFERENCE / "results.md").read_text(encoding="utf-8")
    keys = json.loads((material / "run" / "summary.json").read_text(encoding="utf-8"))
    assert [key for key in keys if f"`{key}`" not in text] == []


def test_the_reference_names_every_topic_and_metadata_record(material: Path) -> None:
    text = (REFERENCE / "recording-format.md").read_text(encoding="utf-8")
    run = open_run(material / "run.mcap")
    assert [name for name in [*run.metadata, *run.topics] if f"`{name}`" not in text] == []


def test_the_simulated_configuration_to_copy_is_the_packaged_one() -> None:
    assert (CONFIGS / "simulated.toml").read_text(encoding="utf-8") == simulated_config_text()


@pytest.mark.parametrize("path", sorted(CONFIGS.glob("*.toml")), ids=lambda path: path.name)
def test_a_configuration_to_copy_is_valid(path: Path) -> None:
    config = load_config(path)
    assert (config.robot is None) == ("robot" not in tomllib.loads(path.read_text(encoding="utf-8")))


def _commands(name: str, command: Any) -> list[tuple[str, Any]]:
    inner = getattr(command, "commands", None)
    if inner is None:
        return [(name, command)]
    return [found for key, one in inner.items() for found in _commands(f"{name} {key}", one)]
