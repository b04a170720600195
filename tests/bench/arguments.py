"""Command line of benchmarks over lengths of a recording."""

import argparse


def parse_arguments(description: str | None, seconds: float) -> argparse.Namespace:
    """Parse seconds of the shortest recording, rounds, seed and json."""
    parser = argparse.ArgumentParser(
        description=description, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seconds", type=float, default=seconds)
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--json", action="store_true")
    return parser.parse_args()
