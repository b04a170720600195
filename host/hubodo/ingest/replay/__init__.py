"""Replay of logs: playback of odometry, decoding of raw frames, and playing to a port."""
