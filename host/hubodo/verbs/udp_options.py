"""Options for keys and trust of verbs that receive UDP."""

from __future__ import annotations

import argparse
from pathlib import Path

from hubodo.ingest.live.record_config import RecordConfig
from hubodo.verbs.setting_options import add_setting_option


def add_udp_arguments(parser: argparse.ArgumentParser) -> None:
    """Add --key-file and --insecure-udp."""
    add_setting_option(parser, RecordConfig, "key_file", parse=Path)
    add_setting_option(parser, RecordConfig, "insecure_udp")


def udp_settings(args: argparse.Namespace) -> dict[str, object]:
    """Return the UDP options as settings of `RecordConfig`; None where an option is not given."""
    key_file = None if args.key_file is None else str(args.key_file)
    return {"key_file": key_file, "insecure_udp": args.insecure_udp or None}
