"""The page in a real browser: every figure takes its place and has colour, and no request leaves it."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
from html import unescape
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from synthetic_results import curvature_at, make_results

from bench.report.html import write_report

NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")
BROWSER = next((path for path in map(shutil.which, NAMES) if path), None)
WIDTH, HEIGHT = 1100, 5200
BOXES = """<script>
addEventListener("load", () => {
  const boxes = [...document.querySelectorAll("figure svg")].map(svg => {
    const box = svg.getBoundingClientRect();
    return [box.left, box.top, box.width, box.height, svg.querySelectorAll("text, path, image").length];
  });
  document.body.dataset.boxes = JSON.stringify(boxes);
  document.body.dataset.spill = document.documentElement.scrollWidth - innerWidth;
});
</script></body>"""

pytestmark = pytest.mark.skipif(BROWSER is None, reason=f"no browser on PATH (looked for {', '.join(NAMES)})")


def browse(page: Path, folder: Path, *options: str) -> str:
    """Open a page in a fresh headless browser that can reach no host, and return what it printed."""
    command = [
        str(BROWSER),
        "--headless",
        "--no-sandbox",
        "--disable-gpu",
        "--hide-scrollbars",
        "--no-first-run",
        "--disable-background-networking",
        "--disable-component-update",
        "--disable-sync",
        "--disable-quic",
        "--disable-dev-shm-usage",
        "--host-resolver-rules=MAP * ~NOTFOUND",
        f"--user-data-dir={folder / 'profile'}",
        f"--window-size={WIDTH},{HEIGHT}",
        *options,
        page.as_uri(),
    ]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout


def requests_of_page(log: Path) -> list[str]:
    """Return the addresses that the page asked for; the browser's own errands have no page as initiator."""
    recorded = json.loads(log.read_text("utf-8"))
    start = recorded["constants"]["logEventTypes"]["URL_REQUEST_START_JOB"]
    asked = [
        event["params"] for event in recorded["events"] if event["type"] == start and "url" in event.get("params", {})
    ]
    return [one["url"] for one in asked if one.get("initiator") != "not an origin"]


@pytest.fixture(scope="module")
def report(tmp_path_factory: pytest.TempPathFactory) -> Path:
    holes = 1.4 * curvature_at(np.arange(100) / 100)
    holes[20:40, 30:60] = np.nan
    results = make_results(20, bend_map_per_m=holes, attention={3: ["slow: 2.41 s"], 7: ["gap"]})
    return write_report(results, tmp_path_factory.mktemp("report"))


def test_the_page_makes_no_request_and_draws_every_figure(report, tmp_path):
    log, picture = tmp_path / "net.json", tmp_path / "page.png"
    browse(report, tmp_path, f"--log-net-log={log}", f"--screenshot={picture}")
    assert requests_of_page(log) == []

    measured = tmp_path / "measured.html"
    text = report.read_text("utf-8")
    measured.write_text(re.sub(r"<meta http-equiv=.*?>", "", text).replace("</body>", BOXES), "utf-8")
    body = re.search(r"<body[^>]*>", browse(measured, tmp_path / "second", "--dump-dom")).group()
    boxes = json.loads(unescape(re.search(r'data-boxes="([^"]*)"', body).group(1)))
    assert 'data-spill="0"' in body, "the page is wider than the window"
    assert len(boxes) == 4
    with Image.open(picture) as screen:
        for left, top, width, height, parts in boxes:
            assert width > 800
            assert height > 100
            assert parts > 20
            shown = screen.convert("RGB").crop((round(left), round(top), round(left + width), round(top + height)))
            assert len(shown.getcolors(maxcolors=1_000_000)) > 40
        left, top, width, height, _ = boxes[3]
        middle = screen.convert("RGB").crop(
            (round(left + 0.3 * width), round(top + 0.3 * height), round(left + 0.7 * width), round(top + 0.7 * height))
        )
        assert len(middle.getcolors(maxcolors=1_000_000)) > 200, "the map's picture is not shown"


def test_a_page_that_does_make_a_request_is_caught(tmp_path):
    page, log = tmp_path / "page.html", tmp_path / "net.json"
    page.write_text("<!DOCTYPE html><title>control</title><img src='http://somewhere.invalid/picture.png'>", "utf-8")
    browse(page, tmp_path, f"--log-net-log={log}", f"--screenshot={tmp_path / 'page.png'}")
    assert requests_of_page(log) == ["http://somewhere.invalid/picture.png"]


def test_the_page_prints(report, tmp_path):
    browse(report, tmp_path, "--no-pdf-header-footer", f"--print-to-pdf={tmp_path / 'page.pdf'}")
    assert (tmp_path / "page.pdf").read_bytes().startswith(b"%PDF-")
