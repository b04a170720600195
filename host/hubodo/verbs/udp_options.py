"""Options for keys and trust of verbs that receive UDP."""

from __future__ import annotations

import argparse
from pathlib import Path


def add_udp_arguments(parser: argparse.ArgumentParser) -> None:
    """Add --key-file and --insecure-udp."""
    parser.add_argument(
        "--key-file",
        type=Path,
        metavar="TOML",
        help="keys of nodes on UDP, as written by `hubodo flash --key-file`; messages without a valid key "
        "are rejected, by the nodes too",
    )
    parser.add_argument(
        "--insecure-udp",
        action="store_true",
        help="accept UDP without keys from other machines: anybody on the network can then send samples and "
        "commands (not needed for 127.0.0.1)",
    )


def udp_settings(args: argparse.Namespace) -> dict[str, object]:
    """Return the UDP options as settings of `RecordConfig`; None where an option is not given."""
    key_file = None if args.key_file is None else str(args.key_file)
    return {"key_file": key_file, "insecure_udp": args.insecure_udp or None}
