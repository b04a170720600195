"""Settings `[ros2]` of hubodo.toml, completed by the environment variables of ROS 2."""

from __future__ import annotations

import os
import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

from hubodo.errors import ConfigError
from hubodo.settings_table import check_bounds, setting
from hubodo.toml_file import load_toml, read_table

TransportName = Literal["dds", "zenoh"]

MAX_DOMAIN = 232
"""Largest domain of DDS, whose ports are computed from it."""
_NODE_NAME = re.compile(r"[A-Za-z_][A-Za-z0-9_]*")


@dataclass(frozen=True, slots=True)
class Ros2Config:
    """Settings of ``[ros2]`` in hubodo.toml; the command line overrides them."""

    publish: Literal["dds", "zenoh"] | None = setting(
        None,
        'Publish odometry, frames and sensor data as a ROS 2 node over "dds", or over "zenoh" for '
        "rmw_zenoh; by default there is none.",
        example="dds",
    )
    transport: Literal["dds", "zenoh"] = setting(
        "dds", 'Transport of ports ros2:/topic, where nothing is published: "dds" or "zenoh".'
    )
    domain: int | None = setting(
        None,
        "ROS domain; by default the variable ROS_DOMAIN_ID, else 0.",
        example=0,
        at_least=0,
        at_most=MAX_DOMAIN,
    )
    network: Literal["localhost", "subnet"] | None = setting(
        None,
        'Computers that can see the node: "localhost" for this one alone, or "subnet"; by default the '
        "variable ROS_AUTOMATIC_DISCOVERY_RANGE, else localhost.",
        example="subnet",
    )
    node: str = setting("hubodo", "Name of the ROS 2 node.")
    distribution: str | None = setting(
        None,
        "ROS 2 distribution of the other nodes; by default the variable ROS_DISTRO. Only humble differs: "
        "its `ros2 node list` expects longer identifiers.",
        example="humble",
    )
    router: str = setting(
        "tcp/localhost:7447", "Zenoh router, as started by `ros2 run rmw_zenoh_cpp rmw_zenohd`."
    )

    @property
    def is_humble(self) -> bool:
        """True if the other nodes run ROS 2 Humble."""
        return self.distribution == "humble"


def load_ros2_config(path: Path) -> Ros2Config:
    """Read `[ros2]` of hubodo.toml; raise ConfigError at the first unknown or invalid setting."""
    config = read_table(load_toml(path).get("ros2", {}), Ros2Config, f"{path}: [ros2]")
    check_bounds(config, lambda key: f"{path}: [ros2] {key} =")
    return config


def complete_config(config: Ros2Config, environment: Mapping[str, str] = os.environ) -> Ros2Config:
    """Return the settings with domain, network and distribution from the environment where not given.

    Raises ConfigError for an invalid domain or node name.
    """
    domain = config.domain
    if domain is None:
        text = environment.get("ROS_DOMAIN_ID", "").strip() or "0"
        if not text.isdecimal() or int(text) > MAX_DOMAIN:
            raise ConfigError(f"ROS_DOMAIN_ID {text!r}: must be a number from 0 to {MAX_DOMAIN}")
        domain = int(text)
    network = config.network
    if network is None:
        wants_subnet = environment.get("ROS_AUTOMATIC_DISCOVERY_RANGE", "").upper() == "SUBNET"
        network = "subnet" if wants_subnet and environment.get("ROS_LOCALHOST_ONLY") != "1" else "localhost"
    if not _NODE_NAME.fullmatch(config.node):
        raise ConfigError(f"[ros2] node = {config.node!r}: write letters, digits and _, such as hubodo")
    distribution = config.distribution or environment.get("ROS_DISTRO") or None
    return replace(config, domain=domain, network=network, distribution=distribution)
