"""ROS 2 topics as ports: messages of other nodes become samples, wheel speeds and fixes of a recording."""
