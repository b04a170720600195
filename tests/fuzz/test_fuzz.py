"""Random inputs of each reader, and the corpus of cases that once showed a defect."""

import random

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fuzz.corpus import load_cases
from fuzz.isolated import run_isolated
from fuzz.judge import judge
from fuzz.targets import TARGETS

EXAMPLES = {
    "mcap": 10, "rosbag1": 5, "rosbag2": 6, "csv": 8, "parquet": 3, "text": 4,
    "npy": 6, "npz": 4,
    "mat": 2, "hdf5": 2, "toml": 15, "frames": 8, "nmea": 20, "options": 5, "http": 4,
}  # fmt: skip


@pytest.mark.parametrize("name", TARGETS)
def test_no_input_shows_a_defect(name: str) -> None:
    """A seed gives the same case in `python tests/fuzz/fuzz.py`, which runs for any time."""

    @settings(max_examples=EXAMPLES[name], derandomize=True, database=None)
    @given(seed=st.integers(0, 2**40))
    def holds(seed: int) -> None:
        judge(TARGETS[name](random.Random(seed)))

    holds()


@pytest.mark.parametrize(("name", "case"), load_cases(), ids=[name for name, _ in load_cases()])
def test_cases_that_once_showed_a_defect_pass(name, case) -> None:
    outcome = run_isolated(case)
    assert outcome.kind == "passed", outcome.text
