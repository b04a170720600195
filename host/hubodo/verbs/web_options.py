"""Options of verbs that offer a live page in the browser or a Foxglove connection."""

from __future__ import annotations

import argparse
import contextlib
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from hubodo.vehicle import Vehicle

if TYPE_CHECKING:
    from hubodo.ingest.live.snapshot_publisher import Audience
    from hubodo.web.config import WebConfig

_DEFAULT_ADDRESS = ""
"""An option without an address: loopback, at the port defined in `hubodo.web.config`."""


def add_web_arguments(parser: argparse.ArgumentParser) -> None:
    """Add --web, the access options and --foxglove."""
    parser.add_argument(
        "--web",
        nargs="?",
        const=_DEFAULT_ADDRESS,
        metavar="HOST:PORT",
        help="serve a live page for the browser (default 127.0.0.1:8642); other computers need a token",
    )
    add_access_arguments(parser)
    add_foxglove_argument(parser)


def add_foxglove_argument(parser: argparse.ArgumentParser) -> None:
    """Add --foxglove."""
    parser.add_argument(
        "--foxglove",
        nargs="?",
        const=_DEFAULT_ADDRESS,
        metavar="HOST:PORT",
        help="serve the topics to the live connection of Foxglove (default 127.0.0.1:8765)",
    )


def add_access_arguments(parser: argparse.ArgumentParser) -> None:
    """Add --token-file, --cert and --key."""
    parser.add_argument(
        "--token-file",
        metavar="FILE",
        help="with the page: file whose first line is the secret that visitors must give",
    )
    parser.add_argument("--cert", metavar="PEM", help="with the page: certificate, for https")
    parser.add_argument("--key", metavar="PEM", help="with the page: its private key")


def web_config(args: argparse.Namespace) -> WebConfig:
    """Return `[web]` of the file of `--config`, overridden by the command-line options."""
    from hubodo.web.config import WebConfig, load_web_config

    config = WebConfig() if args.config is None else load_web_config(args.config)
    options = {name: getattr(args, name, None) for name in ("token_file", "cert", "key", "foxglove")}
    options["listen"] = args.web
    return replace(config, **{key: value for key, value in options.items() if value is not None})


@contextlib.contextmanager
def live_views(args: argparse.Namespace, output: Path, vehicle: Vehicle | None) -> Iterator[Audience | None]:
    """Serve the live page and Foxglove as requested; yield their audience, or None."""
    if args.web is None and args.foxglove is None and args.config is None:
        yield None
        return
    config = web_config(args)
    if config.listen is None and config.foxglove is None:
        yield None
        return
    # Imported here, as the web server takes time to load.
    from hubodo.web.config import foxglove_address, web_site
    from hubodo.web.live import live_audience

    site, foxglove = web_site(config), foxglove_address(config)
    models = {} if args.vehicle is None else {args.vehicle.name: args.vehicle}
    with live_audience(site, foxglove, output.parent, vehicle=vehicle, models=models) as audience:
        yield audience
