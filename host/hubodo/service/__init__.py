"""The recorder as a systemd service: unit, udev rules, installation and removal."""
