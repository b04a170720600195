"""What a benchmark over lengths of a recording can be asked."""

import argparse


def parse_arguments(description: str | None, seconds: float) -> argparse.Namespace:
    """Its command line: seconds of the shortest recording, rounds, seed, json."""
    parser = argparse.ArgumentParser(
        description=description, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seconds", type=float, default=seconds)
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--json", action="store_true")
    return parser.parse_args()
