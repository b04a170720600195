"""The store of finished results."""

import pytest

from hubodo.fleet.listing import LogLocation
from hubodo.fleet.result_store import ResultStore, find_logs_mentioning
from hubodo.fleet.task import DONE, FAILED, Analysis

ANALYSIS = Analysis("info", {}, {}, lambda *_: {})
ONE, TWO = LogLocation("/a/one.mcap", 10, "s1"), LogLocation("/a/two.mcap", 20, "s2")


def row(location, status, **columns):
    shared = {"verb": "info", "analysis": ANALYSIS.digest, "log": location.url, "stamp": location.stamp}
    return {**shared, "size": location.size, "status": status, "quantities": [], "cpu": 1.0, **columns}


@pytest.fixture
def store(tmp_path):
    store = ResultStore(str(tmp_path), ANALYSIS)
    store.add([row(ONE, FAILED, error="disk full"), row(TWO, FAILED, error="worker died")])
    store.add([row(ONE, DONE, key="k1", result='{"cause": "Radio lost"}')])
    return store


def test_a_result_replaces_a_failure_and_is_found_for_an_unchanged_log_only(store):
    assert store.keys() == {"k1"}
    assert store.rows([ONE, TWO])["log"].to_pylist() == [ONE.url]
    assert store.failures([ONE, TWO])["error"].to_pylist() == ["worker died"]
    changed = LogLocation(ONE.url, ONE.size, "other stamp")
    assert len(store.rows([changed])) == 0
    assert (
        len(
            ResultStore(store._folder.removesuffix("/finished"), Analysis("info", {"a": 1}, {}, print)).keys()
        )
        == 0
    )


def test_a_log_of_the_same_content_gets_a_copy_of_the_result(store):
    store.add_copies([row(TWO, DONE, key="k1", vehicle="van-2", start=None, cpu=0.1)])
    rows = store.rows([TWO])
    assert rows["log"].to_pylist() == [TWO.url] and rows["vehicle"].to_pylist() == ["van-2"]


def test_text_is_searched_in_results_without_regard_to_case(store, tmp_path):
    assert find_logs_mentioning(str(tmp_path), "info", "radio LOST") == {ONE.url}
    assert find_logs_mentioning(str(tmp_path), "gap", "radio") == set()
