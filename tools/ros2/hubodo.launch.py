"""Launch file for ROS 2: the recorder as a node, and robot_localization with ekf.yaml beside this file."""

from pathlib import Path

from launch import LaunchDescription
from launch.actions import ExecuteProcess
from launch_ros.actions import Node


def generate_launch_description():
    """Return the processes; hubodo.toml in the working folder names ports, vehicle and log folder."""
    record = ["hubodo", "record", "--config", "hubodo.toml", "--ros2", "--log-format", "json"]
    ekf = str(Path(__file__).with_name("ekf.yaml"))
    return LaunchDescription(
        [
            ExecuteProcess(cmd=record, output="screen"),
            Node(
                package="robot_localization", executable="ekf_node", name="ekf_filter_node", parameters=[ekf]
            ),
        ]
    )
