"""The error tree of hubodo: text says what, where and what to do, in one line."""

from hubodo.safe_text import printable

_MAX_MESSAGE_LENGTH = 2000  # characters; a value of a file that is quoted may be longer than any reader wants


class HubodoError(Exception):
    """Root of all errors that hubodo raises on purpose; str() is one line for the user."""

    def __init__(self, message: str) -> None:
        line = " ".join(printable(message).split())
        super().__init__(line if len(line) <= _MAX_MESSAGE_LENGTH else f"{line[:_MAX_MESSAGE_LENGTH]}...")


class WireMismatch(HubodoError):
    """Node and host were built from different message tables: names both fingerprints, and the remedy."""


class LogError(HubodoError):
    """A recording cannot be read: not MCAP, empty, or damaged beyond what can be skipped."""


class InputError(HubodoError):
    """Input that cannot be accepted: names the file and the row, the existing output, the bad argument."""


class ConfigError(HubodoError):
    """A configuration or model file with an unknown, missing or impossible key."""


class CalibrationError(HubodoError):
    """Data from which a calibration cannot be computed, or a calibration that does not fit the log."""


class LinkError(HubodoError):
    """A port that does not exist, is busy, or speaks another protocol."""
