"""The option by which a verb knows effects that are not in the package."""

from __future__ import annotations

import argparse
from pathlib import Path

from hubodo.effects.loaded import use_effects


def add_effects_option(parser: argparse.ArgumentParser) -> None:
    """--effects."""
    parser.add_argument(
        "--effects",
        type=Path,
        action="append",
        default=[],
        metavar="FILE.py",
        help="Python file with further effects, as gap --scaffold writes them; it is run; again for more",
    )


def know_effects(args: argparse.Namespace) -> None:
    """Add what --effects names, and what installed packages offer."""
    use_effects(args.effects)
