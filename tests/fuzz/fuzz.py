"""Fuzzing for as long as one likes: `python tests/fuzz/fuzz.py mcap csv --seconds 600 --seed 1`; not a test.

A case that breaks what must hold is made smaller, kept in tests/fuzz/corpus and told; exit code 1 then.
"""

from __future__ import annotations

import argparse
import random
import sys
import time
from collections import Counter
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))

from fuzz.kept import keep
from fuzz.targets import TARGETS, judge

_MOST_FOUND = 20


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("target", nargs="*", metavar="TARGET", help="default: all")
    parser.add_argument("--seconds", type=float, default=600.0, help="for each target (default 600)")
    parser.add_argument("--seed", type=int, default=None, help="of the first case (default: by the clock)")
    parser.add_argument("--keep", action="store_true", help="put what is found into the corpus")
    args = parser.parse_args()
    seed = int(time.time()) if args.seed is None else args.seed
    found = sum(hunt(name, args.seconds, seed, keeping=args.keep) for name in args.target or TARGETS)
    return 1 if found else 0


def hunt(name: str, seconds: float, seed: int, *, keeping: bool) -> int:
    """Runs cases of one target until the time is over; how many different ones broke something."""
    codes: Counter[int] = Counter()
    found: dict[str, int] = {}
    end, case_seed = time.monotonic() + seconds, seed * 1_000_003
    while time.monotonic() < end and len(found) < _MOST_FOUND:
        case_seed += 1
        case = TARGETS[name](random.Random(case_seed))
        try:
            codes[judge(case).code] += 1
        except Exception as error:  # noqa: BLE001 what is hunted
            kind = _kind(error)
            if kind not in found:
                found[kind] = case_seed
                print(f"{name}: case {case_seed}: {kind}", flush=True)
                print(f"    {str(error)[:600]}", flush=True)
                if keeping:
                    print(f"    kept as {keep(name, case)}")
    done = ", ".join(f"{count} ended with {code}" for code, count in sorted(codes.items()))
    cases = case_seed - seed * 1_000_003
    print(f"{name}: {seconds:.0f} s, {cases} cases from seed {seed}: {done}; {len(found)} broke")
    return len(found)


def _kind(error: Exception) -> str:
    """What makes two finds the same: the words without numbers."""
    words = "".join("0" if c.isdigit() else c for c in str(error).partition(": ")[2])[:90]
    return f"{type(error).__name__}: {words.partition(': ')[2] or words}"


if __name__ == "__main__":
    sys.exit(main())
