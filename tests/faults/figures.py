"""`make faults`: cost of attacks and foreign files, beside the cost of earlier versions."""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Iterator
from datetime import UTC, datetime
from pathlib import Path
from typing import NamedTuple

TESTS = Path(__file__).parents[1]
sys.path.insert(0, str(TESTS))

# The folder of the tests must come first in the path.
from faults.floods_udp import flood_of_addresses, flood_of_nodes, flood_of_openings  # noqa: E402
from faults.guessing import WAYS, measure  # noqa: E402
from fuzz.fuzz import decode_sentences, fuzz_reader  # noqa: E402
from fuzz.targets import TARGETS  # noqa: E402
from load.idle_connections import PATHS, run  # noqa: E402

MAX_LOGIN_S = 1.0
_SENTENCES = 60_000


class Figure(NamedTuple):
    """A row: attack, earlier result, present result, and whether it meets the requirement."""

    what: str
    before: str
    now: str
    holds: bool


def print_figures(files: int, seconds: float, seed: int | None = None) -> bool:
    """Measure and print each row; return True if all hold."""
    seed = int(datetime.now(UTC).strftime("%Y%m%d")) if seed is None else seed
    holds = True
    for figure in _figures(files, seconds, seed):
        print(f"{figure.what}\n    before: {figure.before}\n    now:    {figure.now}", flush=True)
        holds &= figure.holds
    return holds


def _figures(files: int, seconds: float, seed: int) -> Iterator[Figure]:
    yield from _connections()
    yield from _floods(seconds)
    for path in WAYS:
        guessing = measure(path)
        what = f"the owner's login beside 60 who guess by {path}"
        now = (
            f"{guessing.login_s:.2f} s from their address, {guessing.login_elsewhere_s:.2f} s from another; "
            f"{guessing.guesses_per_s:.0f} guesses/s"
        )
        yield Figure(what, "28.7 s; 1,510 guesses/s", now, guessing.login_s <= MAX_LOGIN_S)
    _, errors = decode_sentences(_SENTENCES, seed)
    what = f"{_SENTENCES} changed NMEA sentences, seed {seed}: exceptions"
    yield Figure(what, "2,374", str(errors.total()), not errors)
    each = -(-files // len(TARGETS))
    bad = sum(fuzz_reader(name, seed, 0.0, each, saving=False) for name in TARGETS)
    what = f"{each * len(TARGETS)} changed files, seed {seed}: defects, over 30 s, over memory"
    yield Figure(what, "43, 14 and 18 of 999", f"{bad} in all", not bad)


def _connections() -> Iterator[Figure]:
    for option in PATHS:
        for count, slow, before in ((1500, False, "the recording ends"), (100, True, "503 for the owner")):
            result = run(option, count, 10.0, slow=slow)
            what = f"{count} {'slow' if slow else 'idle'} connections to the port of {option}"
            yield Figure(what, before, str(result), result.is_complete)


def _floods(seconds: float) -> Iterator[Figure]:
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for what, before, flood in (
            (
                "300 nodes without keys",
                "the recording ends",
                lambda: flood_of_nodes(_create_folder(folder / "a")),
            ),
            (
                "12,000 addresses",
                "1 GB that is kept",
                lambda: flood_of_addresses(_create_folder(folder / "b")),
            ),
            (
                f"300 handshakes a second for {seconds:g} s, forged or sent again",
                "nodes with keys are kept out",
                lambda: flood_of_openings(_create_folder(folder / "c"), seconds),
            ),
        ):
            result = flood()
            text = "never in again" if result.joined_s is None else f"in after {result.joined_s:.2f} s"
            now = (
                f"{result.lost} of {result.sent} samples of four nodes lost, {result.memory_mb:+.0f} MB; "
                f"a node that restarts meanwhile is {text}"
            )
            yield Figure(what, before, now, result.lost == 0 and result.joined_s is not None)


def _create_folder(folder: Path) -> Path:
    folder.mkdir()
    return folder
