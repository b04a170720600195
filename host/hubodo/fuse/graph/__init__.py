"""A factor graph of odometry, GNSS fixes and headings, solved in batch or over a live window."""
