"""Exception classes of hubodo; the message says what, where and what to do, in one line."""

from hubodo.safe_text import printable

_MAX_MESSAGE_LENGTH = 2000  # characters; a quoted value of a file may be arbitrarily long


class HubodoError(Exception):
    """Base class of all errors that hubodo raises on purpose; str() is one line for the user."""

    def __init__(self, message: str) -> None:
        line = " ".join(printable(message).split())
        super().__init__(line if len(line) <= _MAX_MESSAGE_LENGTH else f"{line[:_MAX_MESSAGE_LENGTH]}...")


class WireMismatch(HubodoError):
    """Node and host were built from different message tables; names both fingerprints and the remedy."""


class LogError(HubodoError):
    """A recording that cannot be read: not MCAP, empty, or too damaged to skip the damage."""


class InputError(HubodoError):
    """Input that cannot be accepted: names the file and row, the existing output, or the invalid argument."""


class ConfigError(HubodoError):
    """A configuration or model file with an unknown, missing or invalid key."""


class CalibrationError(HubodoError):
    """Data from which no calibration can be computed, or a calibration that does not fit the log."""


class LinkError(HubodoError):
    """A port that does not exist, is busy, or uses another protocol."""
