"""The recorder as a service of the computer: its systemd unit, its udev rules, and putting them in place."""
