"""ROS 2 without ROS installed: names, message encoding and transports (DDS, Zenoh) of a live node."""
