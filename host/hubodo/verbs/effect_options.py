"""Options that add effects from outside the package."""

from __future__ import annotations

import argparse
from pathlib import Path

from hubodo.effects.loaded import use_effects


def add_effects_option(parser: argparse.ArgumentParser) -> None:
    """Add --effects and --candidates."""
    parser.add_argument(
        "--effects",
        type=Path,
        action="append",
        default=[],
        metavar="FILE.py",
        help="Python file with further effects, as written by gap --scaffold; it is executed; repeatable",
    )

    parser.add_argument(
        "--candidates",
        choices=("list", "field"),
        default="list",
        help="field: consider also effects that a drive can hardly separate from the listed ones (see the "
        "README of the model)",
    )


def register_effects(args: argparse.Namespace) -> None:
    """Register the effects of --effects and of installed packages."""
    use_effects(args.effects, args.candidates == "field")
