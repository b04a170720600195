"""Odometry from inertial sensors on wheel hubs: ingest, recording, estimation and the gap workflow."""

from importlib.metadata import PackageNotFoundError, version

try:
    __version__ = version("hubodo")
except PackageNotFoundError:
    __version__ = "0+uninstalled"
