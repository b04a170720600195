"""Fuzz the readers for any time: `fuzz.py --reader hdf5 --seconds 600`; not a test.

Each case runs in a process of its own within limits of memory and processor time. A case is a defect if it
ends with a traceback, with "a defect of hubodo", by a signal, after 30 s or beyond the memory limit. The
first case of each new kind is saved in tests/fuzz/corpus, which test_fuzz.py replays, and the exit code is 1.
"""

from __future__ import annotations

import os
import random
import sys
import time
from collections import Counter
from datetime import UTC, datetime
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # threads do not survive a fork
sys.path.insert(0, str(Path(__file__).parents[1]))

from fuzz.corpus import save_case
from fuzz.isolated import run_isolated
from fuzz.nmea_cases import sentences
from fuzz.targets import TARGETS
from hubodo.ingest.gnss.nmea import NmeaDecoder
from script_arguments import script_parser

_MOST_KINDS = 20
_SPACING = 1_000_003  # between the first cases of two seeds


def main() -> int:
    """Fuzz the readers named on the command line."""
    parser = script_parser(__doc__)
    parser.add_argument("--reader", action="append", choices=TARGETS, help="repeatable (default: all)")
    parser.add_argument("--seconds", type=float, default=600.0, help="for each reader (default 600)")
    parser.add_argument("--files", type=int, help="cases of each reader, in place of a time")
    parser.add_argument(
        "--sentences", type=int, help="decode this number of changed NMEA sentences, and nothing else"
    )
    parser.add_argument("--seed", type=int, help="of the first case (default: the date, as in 20261124)")
    parser.add_argument("--no-save", action="store_true", help="leave the corpus as it is")
    args = parser.parse_args()
    seed = int(datetime.now(UTC).strftime("%Y%m%d")) if args.seed is None else args.seed
    print(f"seed {seed}", flush=True)
    if args.sentences:
        fixes, errors = decode_sentences(args.sentences, seed)
        print(f"{args.sentences} sentences, {fixes} fixes, {errors.total()} exceptions", *errors.items())
        return 1 if errors else 0
    defects = 0
    for name in args.reader or TARGETS:
        defects += fuzz_reader(name, seed, args.seconds, args.files, saving=not args.no_save)
    return 1 if defects else 0


def fuzz_reader(name: str, seed: int, seconds: float, files: int | None, *, saving: bool) -> int:
    """Run cases of one reader until the time or number limit; return the number of defects."""
    outcomes, codes, kinds = Counter[str](), Counter[str](), set[str]()
    end, first, peak = time.monotonic() + seconds, seed * _SPACING, 0
    number = 0
    while (number < files if files else time.monotonic() < end) and len(kinds) < _MOST_KINDS:
        number += 1
        case = TARGETS[name](random.Random(first + number))
        outcome = run_isolated(case)
        outcomes[outcome.kind] += 1
        peak = max(peak, outcome.peak)
        if outcome.kind == "passed":
            codes[outcome.text[5]] += 1
        elif (signature := _signature(outcome.text)) not in kinds:
            kinds.add(signature)
            print(f"{name}: case {first + number}: {outcome.text[:600]}", flush=True)
            if saving:
                print(f"    saved as {save_case(name, case)}", flush=True)
    counts = ", ".join(f"{count} ended with {code}" for code, count in sorted(codes.items()))
    print(
        f"{name}: {number} files, {outcomes['defect']} defects, {outcomes['slow']} over 30 s, "
        f"{outcomes['memory']} over memory ({len(kinds)} kinds; peak {peak >> 20} MB; {counts})",
        flush=True,
    )
    return number - outcomes["passed"]


def decode_sentences(count: int, seed: int) -> tuple[int, Counter[str]]:
    """Feed changed NMEA sentences to the decoder; return the number of fixes, and the exceptions by type."""
    errors, fixes = Counter[str](), 0
    decoder = NmeaDecoder()
    for number, line in enumerate(sentences(random.Random(seed), count)):
        try:
            fixes += len(list(decoder.feed(line, number * 50_000_000)))
        except Exception as error:  # noqa: BLE001 - what is counted
            errors[type(error).__name__] += 1
    return fixes, errors


def _signature(text: str) -> str:
    """Return what two cases with one cause share: the end of the error without numbers and paths."""
    cause = text.partition("\n")[0]
    words = [word for word in cause.split() if "/" not in word and "FOLDER" not in word]
    return "".join("0" if c.isdigit() else c for c in " ".join(words[-25:]))


if __name__ == "__main__":
    sys.exit(main())
