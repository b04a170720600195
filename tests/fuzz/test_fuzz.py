"""Some hundred inputs made from chance for each target, and the corpus: what once broke something, again."""

import random

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fuzz.kept import kept
from fuzz.targets import TARGETS, judge

SHORT = {"mcap": 70, "bag": 60, "csv": 50, "toml": 50, "frames": 25, "nmea": 60, "options": 15}


@pytest.mark.parametrize("name", TARGETS)
def test_no_input_is_a_defect(name: str) -> None:
    """A seed gives the same case in `python tests/fuzz/fuzz.py`, which goes on for as long as one likes."""

    @settings(max_examples=SHORT[name], derandomize=True, database=None)
    @given(seed=st.integers(0, 2**40))
    def holds(seed: int) -> None:
        judge(TARGETS[name](random.Random(seed)))

    holds()


@pytest.mark.parametrize(("name", "case"), kept(), ids=[name for name, _ in kept()])
def test_what_broke_something_once_breaks_nothing_now(name, case) -> None:
    judge(case)
