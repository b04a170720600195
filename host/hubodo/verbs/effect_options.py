"""The option by which a verb knows effects that are not in the package."""

from __future__ import annotations

import argparse
from pathlib import Path

from hubodo.effects.loaded import use_effects


def add_effects_option(parser: argparse.ArgumentParser) -> None:
    """--effects, --candidates."""
    parser.add_argument(
        "--effects",
        type=Path,
        action="append",
        default=[],
        metavar="FILE.py",
        help="Python file with further effects, as gap --scaffold writes them; it is run; again for more",
    )

    parser.add_argument(
        "--candidates",
        choices=("list", "field"),
        default="list",
        help="field: also effects that a drive hardly tells from those of the list, see the model's README",
    )


def know_effects(args: argparse.Namespace) -> None:
    """Add what --effects names, and what installed packages offer."""
    use_effects(args.effects, args.candidates == "field")
