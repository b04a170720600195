"""The factor graph: odometry, fixes and headings."""
