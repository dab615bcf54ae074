"""A real cable moved by a robot, in the paper's own file format, scored against its truth."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from sorting_score import SortingScore, read_source, score_source

from bench.config import load_config, to_toml
from bench.model import Outcome
from bench.recording import open_run
from bench.report.pipeline import analyse_run
from bench.report.results import Results
from bench.report.tables import write_tables
from bench.run.import_take import import_take
from bench.timing import RunClock


def report(shared_data: Path, name: str, folder: Path, sorting: str) -> tuple[Results, SortingScore]:
    cable = shared_data / "cable" / name
    config = load_config(cable.with_suffix(".toml"))
    config = config.model_copy(update={"analysis": config.analysis.model_copy(update={"sorting": sorting})})
    import_take(cable.with_suffix(".csv"), config, to_toml(config), folder / "run.mcap", RunClock.start())
    results = analyse_run(open_run(folder / "run.mcap"))
    write_tables(results, folder / "out")
    with np.load(cable.with_suffix(".truth.npz")) as truth:
        return results, score_source(read_source(folder / "out" / "markers.parquet"), truth["source"])


@pytest.mark.parametrize("sorting", ["paper", "chain"])
def test_the_clean_take_is_sorted_exactly(shared_data: Path, tmp_path: Path, sorting: str) -> None:
    results, score = report(shared_data, "cable_a_clean", tmp_path, sorting)
    assert score.exact >= 0.999
    assert score.wrong == 0
    assert results.outcome is Outcome.PASS
    assert results.cycles.n_frames.tolist() == [1000]


def test_the_hard_take_is_sorted_as_far_as_the_papers_chain_goes(
    shared_data: Path, tmp_path: Path, record_property: Callable[[str, object], None]
) -> None:
    results, score = report(shared_data, "cable_a_hard", tmp_path, "paper")
    record_property("score", str(score))
    assert score.exact > 0.25  # measured 0.307: the chain ends at the first hidden marker
    assert score.wrong < 0.20  # measured 0.127
    assert score.recall > 0.45
    assert any("All markers were found in" in warning for warning in results.warnings)


def test_the_hard_take_is_sorted_by_the_chain_search(
    shared_data: Path, tmp_path: Path, record_property: Callable[[str, object], None]
) -> None:
    _, score = report(shared_data, "cable_a_hard", tmp_path, "chain")
    record_property("score", str(score))
    assert score.exact > 0.99  # measured 0.998
    assert score.wrong < 0.005  # measured 0.002: a ghost that rides along beside a hidden marker
    assert score.recall > 0.999
