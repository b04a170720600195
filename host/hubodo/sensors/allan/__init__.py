"""The Allan deviation of a rest, its noise terms and their sigmas."""
