"""Options for keys and trust of verbs that receive UDP or Bluetooth."""

from __future__ import annotations

import argparse
from pathlib import Path

from hubodo.ingest.live.record_config import RecordConfig
from hubodo.verbs.setting_options import add_setting_option


def add_key_arguments(parser: argparse.ArgumentParser) -> None:
    """Add --key-file, --insecure-udp and --insecure-ble."""
    add_setting_option(parser, RecordConfig, "key_file", parse=Path)
    add_setting_option(parser, RecordConfig, "insecure_udp")
    add_setting_option(parser, RecordConfig, "insecure_ble")


def insecure_kinds(args: argparse.Namespace) -> tuple[str, ...]:
    """Return the kinds of ports that the options let accept nodes without keys."""
    return RecordConfig(insecure_udp=args.insecure_udp, insecure_ble=args.insecure_ble).insecure_kinds


def key_settings(args: argparse.Namespace) -> dict[str, object]:
    """Return these options as settings of `RecordConfig`; None where an option is not given."""
    return {
        "key_file": None if args.key_file is None else str(args.key_file),
        "insecure_udp": args.insecure_udp or None,
        "insecure_ble": args.insecure_ble or None,
    }
