"""The page: whole, self-contained, honest about what is missing, and safe against the names it is given."""

from __future__ import annotations

import dataclasses
import re
from functools import cache
from html.parser import HTMLParser

import numpy as np
import pytest
from markupsafe import Markup
from synthetic_results import GRID_M, make_results

from bench.errors import RecordingError, RecordingExistsError
from bench.model import Outcome, Severity
from bench.report.html import ATTENTION_ROWS, NOTED_ROWS, render_report, write_report
from bench.report.results import ClockFinding, NotedLine, StreamFinding

VOID = {"area", "base", "br", "col", "hr", "img", "input", "link", "meta", "source", "wbr"}
HOSTILE = "<script>alert(1)</script>\"'><img src=http://evil.example/x onerror=alert(2)>{{ 7 * 7 }}"


class Page(HTMLParser):
    """Reads a page as a strict reader would: every element closed, in order."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.elements: list[tuple[str, dict[str, str | None]]] = []
        self.words: list[str] = []
        self.feed(text)
        self.close()
        assert self.open == [], f"never closed: {self.open}"

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.elements.append((tag, dict(attrs)))
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.elements.append((tag, dict(attrs)))

    def handle_endtag(self, tag: str) -> None:
        assert self.open, f"</{tag}> closes nothing"
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        if "style" not in self.open:
            self.words.append(data)

    @property
    def text(self) -> str:
        return re.sub(r"\s+", " ", " ".join(self.words))

    def all(self, tag: str) -> list[dict[str, str | None]]:
        return [attributes for name, attributes in self.elements if name == tag]


@pytest.fixture
def no_figures(monkeypatch):
    """Leave the figures out: they take half a second, and have tests of their own."""
    names = ("example", "cycles", "completeness", "bend_map")
    monkeypatch.setattr("bench.report.html._figures", lambda _: dict.fromkeys(names, Markup("<svg></svg>")))


words_only = pytest.mark.usefixtures("no_figures")


@cache
def usual_page() -> str:
    return render_report(make_results(3, attention={1: ["slow"]}))


def unseen(n_cycles: int):
    nothing = np.full(n_cycles, np.nan)
    names = ("duration_s", "complete_fraction", "max_curvature_per_m", "max_curvature_sigma_per_m")
    names += ("max_curvature_arc_length_m", "min_bend_radius_mm", "mean_curvature_per_m")
    return dataclasses.replace(make_results(n_cycles).cycles, **dict.fromkeys(names, nothing))


@words_only
def test_the_first_screen_answers_what_one_asks_in_the_morning():
    text = Page(render_report(make_results(20))).text
    first = text[: text.index("What was run")]
    for answer in ("dresspack-07", "LAPP-8x1.0-03", "PASS", "No bend tighter", "65.6", "limit 60 mm", "20 all ok"):
        assert answer in first
    assert "nothing dropped, nothing missed" in first
    assert re.search(r"1140\smm from the anchor, cycle 2, phase 0\.\d{2}\b", first)
    assert "robot: drift +25.0 ppm, residual 71 µs" in first
    assert "Beside the clamps the cable may be bent tighter than any radius on this page: a spline" in first


def test_every_section_is_there_in_order():
    page = Page(usual_page())
    headings = [
        "What was run",
        "One frame, from points to curvature",
        "Largest curvature per cycle",
        "Bend-radius map",
        "Cycles that need a look",
        "What the run noted",
        "Losses, stream by stream",
        "Clocks",
        "Methods and their limits",
        "Files and versions",
    ]
    places = [page.text.index(f" {heading} ") for heading in headings]
    assert places == sorted(places)
    figures = [attributes for attributes in page.all("svg") if attributes.get("role") == "img"]
    assert len(figures) == 4
    assert all(attributes["aria-labelledby"] for attributes in figures)


def test_the_page_asks_the_network_for_nothing_and_runs_no_script():
    text = usual_page()
    page = Page(text)
    for _, attributes in page.elements:
        for name, value in attributes.items():
            if name.split(":")[-1] in {"src", "href", "srcset", "action", "data"}:
                assert value.startswith(("#", "data:image/png;base64,"))
    assert not page.all("script")
    assert not page.all("link")
    style = text.split("<style>")[1].split("</style>")[0]
    assert "url(" not in style
    assert "@import" not in style
    policy = next(a["content"] for a in page.all("meta") if a.get("http-equiv") == "Content-Security-Policy")
    assert policy.startswith("default-src 'none'")


def test_ids_are_unique_and_links_lead_somewhere():
    page = Page(usual_page())
    ids = [attributes["id"] for _, attributes in page.elements if "id" in attributes]
    assert len(ids) == len(set(ids))
    assert {a["href"] for a in page.all("a")} <= {f"#{name}" for name in ids}


@words_only
def test_tables_have_headers_with_a_scope_and_a_caption():
    page = Page(render_report(make_results(3, attention={1: ["slow"]})))
    assert len(page.all("table")) == len(page.all("caption")) == 3
    assert all(attributes.get("scope") in {"col", "row"} for attributes in page.all("th"))


def test_hostile_names_stay_text_everywhere():
    results = make_results(3)
    run = results.config.run.model_copy(update={"sample_id": HOSTILE, "name": HOSTILE})
    results = dataclasses.replace(
        results,
        config=results.config.model_copy(update={"run": run}),
        run_path=HOSTILE,
        run_facts={HOSTILE: HOSTILE},
        exit_status=HOSTILE,
        exit_reason=HOSTILE,
        outcome_reasons=[HOSTILE],
        warnings=[HOSTILE],
        attention={1: [HOSTILE]},
        noted=[NotedLine(0, Severity.WARN, HOSTILE, HOSTILE)],
        streams=[StreamFinding(HOSTILE, 1.0, 1, 1, 0, 0)],
        clocks=[ClockFinding(HOSTILE, 0, HOSTILE, 0.0, 0.0, 0.0, 1)],
        versions={HOSTILE: HOSTILE, "bench": HOSTILE},
        methods={"sorting": HOSTILE, HOSTILE: HOSTILE},
        config_sha256=HOSTILE,
    )
    page = Page(render_report(results))
    assert not page.all("script")
    assert not page.all("img")
    assert not any(name.startswith("on") for _, attributes in page.elements for name in attributes)
    assert page.text.count("{{ 7 * 7 }}") >= 15


@words_only
def test_what_the_run_noted_is_told_with_its_time():
    noted = [NotedLine(1_700_000_000_250_000_000, Severity.ERROR, "robot", "The controller closed the connection.")]
    page = Page(render_report(make_results(1, noted=noted)))
    assert "2023-11-14 22:13:20.250 error robot The controller closed the connection." in page.text


@words_only
def test_a_long_log_shows_its_warnings_first_and_says_how_much_is_left_out():
    noted = [NotedLine(n, Severity.INFO, "run", f"info {n}.") for n in range(NOTED_ROWS)]
    noted += [NotedLine(n, Severity.WARN, "run", f"warning {n}.") for n in range(NOTED_ROWS + 5)]
    page = Page(render_report(make_results(1, noted=noted)))
    assert "info 0." not in page.text
    assert f"warning {NOTED_ROWS - 1}." in page.text
    assert f"warning {NOTED_ROWS}." not in page.text
    assert f"And {NOTED_ROWS + 5} more: topic /log of the recording." in page.text


@words_only
def test_characters_that_turn_or_hide_text_are_made_visible():
    run_facts = {"Operator": "a\u202eb\u2066c\x00d\x1be"}
    assert "a\ufffdb\ufffdc\ufffdd\ufffde" in render_report(make_results(1, run_facts=run_facts))


@words_only
def test_a_name_that_is_no_unicode_text_can_be_written(tmp_path):
    path = write_report(make_results(1, run_path="bad\udcff.mcap"), tmp_path)
    assert "bad\\udcff.mcap" in path.read_text("utf-8")


@words_only
@pytest.mark.parametrize(
    ("outcome", "meaning"),
    [
        (Outcome.FAIL, "The cable did not pass."),
        (Outcome.ERROR, "This is no verdict on the cable: the bench, or what it recorded, was at fault."),
    ],
)
def test_the_outcome_is_said_in_words_with_its_reasons(outcome, meaning):
    page = Page(render_report(make_results(3, outcome=outcome, outcome_reasons=["Because of this."])))
    assert f"{outcome.value} {meaning} Because of this." in page.text


@words_only
def test_a_limit_inside_the_interval_is_said_to_be_undecided():
    results = make_results(3)
    value = np.array([15.0, 16.5, 15.0])
    cycles = dataclasses.replace(results.cycles, max_curvature_per_m=value, min_bend_radius_mm=1e3 / value)
    assert "by noise alone it may be on either side" in render_report(dataclasses.replace(results, cycles=cycles))
    assert "by noise alone" not in render_report(results)


@words_only
def test_an_unfinished_recording_is_said_so_first():
    results = make_results(3, exit_status="unfinished", exit_reason="truncated at byte 4711")
    text = Page(render_report(results)).text
    assert text.index("This recording was never finished.") < text.index("Smallest bend radius")
    assert "truncated at byte 4711" in text


def test_the_table_of_clocks_says_who_stamped_the_arrivals():
    page = usual_page()
    assert "<td>lower convex hull, arrivals by the kernel</td>" in page
    assert "<td>echoes</td>" in page


def test_no_cycle_no_stream_no_clock_and_no_example_are_each_said():
    results = make_results(
        0, example=None, streams=[], clocks=[], bend_map_per_m=np.full((100, GRID_M.size), np.nan), run_facts={}
    )
    text = Page(render_report(results)).text
    for sentence in (
        "no cycle was completed",
        "There was no cycle to judge.",
        "This recording counts no streams.",
        "No device clock was compared",
        "No frame was complete enough",
        "there is no map to draw",
        "not measured; limit 60 mm",
    ):
        assert sentence in text
    assert "Beside the clamps the cable may" not in text


def test_cycles_in_which_nothing_was_seen_show_dashes_and_no_nan():
    results = make_results(3, cycles=unseen(3), attention={1: ["no frame of it has a trusted curve"], 99: ["lost"]})
    text = Page(render_report(results)).text
    assert "no frame of it has a trusted curve" in text
    assert "lost" in text
    assert not re.search(r"\bnan\b|\binf\b|None", text)


@words_only
def test_losses_are_counted_and_named():
    streams = [StreamFinding("/robot/state", 500.0, 1000, 990, 10, 0), StreamFinding("/log", float("nan"), 3, 3, 0, 2)]
    text = Page(render_report(make_results(3, streams=streams))).text
    assert "10 dropped by the bench, 2 never came from the log; 993 records written" in text


@words_only
def test_many_odd_cycles_are_cut_with_a_word_where_the_rest_is():
    page = Page(render_report(make_results(300, 1, attention={i: ["slow"] for i in range(300)})))
    assert len([a for a in page.all("th") if a["scope"] == "row"]) == ATTENTION_ROWS + 4
    assert "And 100 more: see cycles.parquet." in page.text


def test_ten_thousand_cycles_make_a_page_below_two_megabytes():
    odd = {i: ["it took 2.41 s, 1.21 times the median", "gap"] for i in range(10_000)}
    assert len(render_report(make_results(10_000, 1, attention=odd)).encode()) < 2_000_000


def test_the_same_results_give_the_same_page():
    assert render_report(make_results(2, example=None)) == render_report(make_results(2, example=None))


@words_only
def test_a_report_is_never_overwritten(tmp_path):
    path = write_report(make_results(1), tmp_path / "new" / "folder")
    before = path.read_bytes()
    with pytest.raises(RecordingExistsError, match=r"report\.html exists already"):
        write_report(make_results(2), tmp_path / "new" / "folder")
    assert path.read_bytes() == before


@words_only
def test_a_folder_that_cannot_be_made_is_one_sentence(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(RecordingError, match="cannot be written"):
        write_report(make_results(1), tmp_path / "file" / "below")
