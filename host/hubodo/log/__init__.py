"""Read and write logs: MCAP, rosbags, CSV folders and number files."""
