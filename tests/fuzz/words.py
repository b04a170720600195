"""The command lines that read a log, with LOG and FOLDER in place of paths."""

from __future__ import annotations

LOG_READERS: tuple[tuple[str, ...], ...] = (
    ("info", "LOG", "--json"),
    ("info", "LOG"),
    ("export", "LOG", "-o", "FOLDER/out"),
    ("fuse", "LOG", "--vehicle", "FOLDER/v.toml", "-o", "FOLDER/out"),
    ("fuse", "LOG", "--vehicle", "FOLDER/v.toml", "-o", "FOLDER/out", "--smooth"),
    ("fuse", "LOG", "--vehicle", "FOLDER/v.toml", "-o", "FOLDER/out", "--method", "differential"),
    ("allan", "LOG", "--node", "left", "--channel", "gz", "--as-is", "--trust-units", "--json"),
    ("allan", "LOG", "--node", "left", "--channel", "gz", "--trust-still", "--trust-units"),
    ("warmup", "LOG", "--node", "left", "--channel", "gz", "--trust-still", "--trust-units"),
    ("heading", "LOG", "--node", "left", "--axis", "y", "-o", "FOLDER/h.csv"),
    ("calibrate", "wheels", "LOG", "--vehicle", "FOLDER/v.toml", "-o", "FOLDER/c.toml"),
    ("calibrate", "imu", "LOG", "--node", "left", "-o", "FOLDER/c.toml"),
    ("north", "LOG", "--node", "left", "--axis", "x", "--latitude-deg", "47"),
    ("play", "LOG", "--speed", "0"),
    ("gap", "FOLDER/m.toml", "LOG", "-o", "FOLDER/out"),
    ("report", "LOG", "-o", "FOLDER/r.html"),
    ("simulate", "FOLDER/m.toml", "--drive", "reference", "--from", "LOG", "-o", "FOLDER/s.mcap"),
    ("simulate", "FOLDER/m.toml", "--drive", "gnss", "--from", "LOG", "-o", "FOLDER/s.mcap"),
)
"""The quick ones come first."""
QUICK = 6


def at(words: tuple[str, ...], log: str) -> tuple[str, ...]:
    """Return the words with the path of a log in them."""
    return tuple(log if word == "LOG" else word for word in words)
