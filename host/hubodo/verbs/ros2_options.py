"""Options of verbs that take part in ROS 2."""

from __future__ import annotations

import argparse
from dataclasses import replace
from typing import get_args

from hubodo.ros2.config import Ros2Config, TransportName, complete_config, load_ros2_config
from hubodo.ros2.transport import require_transport

_DEFAULT_TRANSPORT = "dds"


def add_ros2_arguments(parser: argparse.ArgumentParser) -> None:
    """Add --ros2."""
    parser.add_argument(
        "--ros2",
        nargs="?",
        const=_DEFAULT_TRANSPORT,
        choices=get_args(TransportName),
        help=(
            "publish /odom, /tf and sensor data as a ROS 2 node, by default over DDS and to this computer "
            "alone; see [ros2] of hubodo.toml"
        ),
    )


def ros2_config(args: argparse.Namespace, *, has_topics: bool = False) -> Ros2Config:
    """Return `[ros2]` of the file of `--config`, with the options applied.

    has_topics: True if a port is a ROS 2 topic. The environment of ROS is read only if something is received
    or published, so that an invalid one cannot stop other recordings.
    """
    config = Ros2Config() if args.config is None else load_ros2_config(args.config)
    config = config if args.ros2 is None else replace(config, publish=args.ros2)
    if config.publish is None and not has_topics:
        return config
    require_transport(config.publish or config.transport)
    return complete_config(config)
