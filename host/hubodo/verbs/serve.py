"""`hubodo serve`: show the recordings of a folder in the browser, with reports and `gap`."""

from __future__ import annotations

import argparse
import sys
import threading
from dataclasses import replace
from pathlib import Path

from hubodo.errors import InputError
from hubodo.ingest.stop_signals import stop_on_signals
from hubodo.listening.descriptors import raise_descriptor_limit
from hubodo.verbs.web_options import add_access_arguments, web_config

EXAMPLE = (
    "hubodo serve drives/\n  hubodo serve drives/ --at 0.0.0.0:8642 --token-file token.txt\n"
    "  hubodo serve drives/ --config hubodo.toml"
)
_STOP_POLL_S = 0.5


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of `hubodo serve`."""
    parser.add_argument("folder", type=Path, metavar="FOLDER", help="folder of logs (.mcap)")
    parser.add_argument("--config", type=Path, metavar="TOML", help="hubodo.toml, for its table [web]")
    parser.add_argument(
        "--at",
        dest="web",
        metavar="HOST:PORT",
        help="address to listen on (default 127.0.0.1:8642); other computers need a token",
    )
    add_access_arguments(parser)


def run(args: argparse.Namespace) -> None:
    """Serve the pages until ctrl-C.

    Raises
    ------
    InputError
        If the folder does not exist, or the address cannot be used.
    """
    from hubodo.ingest.live.program_log import program_log
    from hubodo.web.app import make_app
    from hubodo.web.config import web_site
    from hubodo.web.library import RecordingLibrary
    from hubodo.web.server import serve_in_thread

    if not args.folder.is_dir():
        raise InputError(f"{args.folder}: is no folder; give a folder of logs")
    raise_descriptor_limit()
    config = web_config(args)
    config = replace(config, listen=config.listen or "")
    site = web_site(config)
    assert site is not None
    app = make_app(site, RecordingLibrary(args.folder))
    with (
        program_log("serve"),
        stop_on_signals(threading.Event()) as stopping,
        serve_in_thread(app, site) as port,
    ):
        url = replace(site, address=replace(site.address, port=port)).url
        print(f"hubodo serve: {args.folder} at {url}; stop with ctrl-C", file=sys.stderr, flush=True)
        while not stopping.wait(_STOP_POLL_S):
            pass
