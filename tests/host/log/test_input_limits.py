"""Sizes and paths in a file are checked before memory is allocated or a path is opened."""

import argparse
import os
import threading

import pytest

from hubodo.errors import InputError
from hubodo.log import input_limits
from hubodo.log.input_limits import MemoryBudget, check_claim, limit_bytes, memory_limit, open_regular
from hubodo.verbs import VERBS, load_verb
from in_process import hubodo


def test_the_limit_is_a_quarter_of_the_memory_unless_a_block_sets_another() -> None:
    default = limit_bytes()
    assert default == int(input_limits.machine_memory() / 4) > 0
    with memory_limit(1000):
        assert limit_bytes() == 1000
        with memory_limit(None):
            assert limit_bytes() == 1000
    assert limit_bytes() == default


def test_sizes_of_one_file_are_summed(tmp_path) -> None:
    budget = MemoryBudget(tmp_path / "x", limit=100)
    budget.claim(60, "the first part")
    with pytest.raises(
        InputError,
        match=r"x: the second part needs 120 bytes of memory, the limit is 100 bytes.*--max-memory",
    ):
        budget.claim(60, "the second part")
    with pytest.raises(InputError, match="negative size"):
        check_claim(-1, tmp_path / "x", "its header")


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="this system has no FIFO")
def test_a_fifo_or_device_is_refused_at_once(tmp_path) -> None:
    os.mkfifo(tmp_path / "pipe")
    refused = []

    def open_both() -> None:
        for path in (tmp_path / "pipe", "/dev/null"):
            with pytest.raises(InputError, match="not a regular file"):
                open_regular(path)
            refused.append(path)

    opening = threading.Thread(target=open_both, daemon=True)
    opening.start()
    opening.join(60)
    assert len(refused) == 2
    with pytest.raises(IsADirectoryError):
        open_regular(tmp_path)


def test_every_verb_that_reads_a_log_has_max_memory() -> None:
    reading = set()
    for verb in VERBS:
        parser = argparse.ArgumentParser()
        load_verb(verb).add_arguments(parser)
        words = parser.format_help()
        if verb == "calibrate":
            continue  # its two subcommands follow
        if "log" in {action.dest for action in parser._actions} and "--max-memory" not in words:
            reading.add(verb)
    assert not reading
    for words in (("calibrate", "imu"), ("calibrate", "wheels"), ("batch", "info")):
        assert "--max-memory" in hubodo(*words, "--help").out


@pytest.mark.parametrize("n_bytes", [10**18, 10**400, 10**5000], ids=["19 digits", "401", "5001"])
def test_a_size_of_any_number_of_digits_is_refused_in_one_short_line(n_bytes, tmp_path):
    with pytest.raises(InputError, match="needs over an exabyte of memory") as refused:
        check_claim(n_bytes, tmp_path / "x.npy", "the array")
    assert len(str(refused.value)) < 300 + len(str(tmp_path))
