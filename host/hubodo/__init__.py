"""Odometry from inertial sensors on wheel hubs: ingest, recording, estimation and the gap workflow."""

__version__ = "0.1.0"
