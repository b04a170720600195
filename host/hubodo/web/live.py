"""Set-up of the live page and of Foxglove for one recording."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

from hubodo.ingest.live.snapshot_publisher import Audience
from hubodo.listening.server_thread import ServerFaults
from hubodo.vehicle import Vehicle
from hubodo.version import __version__
from hubodo.web.actions import Actions
from hubodo.web.address import Address
from hubodo.web.app import make_app
from hubodo.web.config import Site
from hubodo.web.foxglove_live import FoxgloveLive
from hubodo.web.hub import FrameHub
from hubodo.web.library import RecordingLibrary
from hubodo.web.live_page import LivePage
from hubodo.web.server import serve_in_thread


@contextlib.contextmanager
def live_audience(
    site: Site | None,
    foxglove: Address | None,
    folder: Path,
    *,
    vehicle: Vehicle | None = None,
    models: dict[str, Path] | None = None,
) -> Iterator[Audience | None]:
    """Serve the page and Foxglove as requested; yield their audience, or None.

    The recording prints the addresses in its first turn. models: model files for `gap` besides the TOML files
    of the folder. Raises InputError if an address cannot be used.
    """
    with contextlib.ExitStack() as stack:
        live: FoxgloveLive | None = None
        startup_lines: list[str] = []
        if foxglove is not None:
            live = stack.enter_context(FoxgloveLive(foxglove))
            startup_lines.append(
                f"Foxglove: open connection ws://{replace(foxglove, port=live.clients.port)}"
            )
        if site is None:
            if live is not None:
                live.startup_lines = startup_lines
            yield live
            return
        hub, faults = FrameHub(_about(vehicle)), ServerFaults()
        page = LivePage(hub.put, live, faults)
        app = make_app(site, RecordingLibrary(folder, models), hub, Actions(page))
        port = stack.enter_context(serve_in_thread(app, site, faults))
        startup_lines.append(f"live page at {replace(site, address=replace(site.address, port=port)).url}")
        page.startup_lines = startup_lines
        yield page


def _about(vehicle: Vehicle | None) -> dict[str, Any]:
    sides = {} if vehicle is None else {name: mount.side for name, mount in vehicle.nodes.items()}
    return {"version": __version__, "sides": sides}
