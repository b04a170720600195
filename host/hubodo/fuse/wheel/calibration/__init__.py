"""What a drive with known positions tells about wheels, track and nodes."""
