"""Every command, Python block and TOML block of the documentation runs; what needs a lab has at least valid options."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest
from markdown_pages import ROOT, find_blocks, find_commands, find_pages
from workshop import FIRST_RUN, Workshop

PAGES = [page for page in find_pages() if find_blocks(page)]
LANGUAGES = {"console", "python", "toml", "text"}


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_every_block_of_the_page_works(
    page: Path, material: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = tmp_path / "page"
    shutil.copytree(material, folder)
    monkeypatch.chdir(folder)
    workshop = Workshop(folder, f"127.0.{80 + PAGES.index(page)}", material / "run.mcap")
    for block in find_blocks(page):
        assert block.language in LANGUAGES, f"{block.place}: '{block.language}' is no language of these pages"
        workshop.follow(block)


def test_the_run_that_is_copied_is_one_that_pages_show() -> None:
    commands = [command for page in PAGES for block in find_blocks(page) for command in find_commands(block)]
    assert len([command for command in commands if command.startswith(f"{FIRST_RUN} ")]) > 2


def test_the_pages_do_show_how_to_use_every_command() -> None:
    commands = [command for page in PAGES for block in find_blocks(page) for command in find_commands(block)]
    used = {command.split()[1] for command in commands if command.startswith("bench ")}
    assert {"run", "check", "report", "import", "export", "config"} <= used
