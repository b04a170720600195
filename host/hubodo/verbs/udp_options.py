"""The options by which a verb that listens on UDP is told whom to trust."""

from __future__ import annotations

import argparse
from pathlib import Path


def add_udp_arguments(parser: argparse.ArgumentParser) -> None:
    """--key-file, --insecure-udp."""
    parser.add_argument(
        "--key-file",
        type=Path,
        metavar="TOML",
        help="keys of nodes on UDP, as `hubodo flash --key-file` wrote it: nobody else is heard, nor obeyed "
        "by the nodes",
    )
    parser.add_argument(
        "--insecure-udp",
        action="store_true",
        help="UDP without keys from other machines too: anybody on the network can then send samples and "
        "give orders to the nodes (this machine's own, 127.0.0.1, needs neither)",
    )


def udp_settings(args: argparse.Namespace) -> dict[str, object]:
    """What of `RecordConfig` they say; None where they do not."""
    key_file = None if args.key_file is None else str(args.key_file)
    return {"key_file": key_file, "insecure_udp": args.insecure_udp or None}
