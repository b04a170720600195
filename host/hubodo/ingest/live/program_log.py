"""Log records, warnings and thread exceptions of libraries as one line each on stderr, text or JSON."""

from __future__ import annotations

import logging
import sys
import threading
import time
import traceback
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import Any

from hubodo.ingest.live.timeout_stream import standard_error
from hubodo.ingest.live.view import format_json_line

_LEVELS = {logging.WARNING: "warning", logging.ERROR: "error", logging.CRITICAL: "error"}


@contextmanager
def program_log(verb: str, log_format: str = "text") -> Iterator[None]:
    """Show log records of level WARNING or above, warnings and thread exceptions inside the block.

    Parameters
    ----------
    verb
        Printed before each line of text.
    log_format
        "text" for a line without traceback; "json" for an object with the traceback among its fields.
    """
    root, handler = logging.getLogger(), _LineHandler(verb, log_format)
    hooks = threading.excepthook, sys.unraisablehook
    root.addHandler(handler)
    logging.captureWarnings(True)
    threading.excepthook = lambda args: _log_exception(args.exc_value, "thread")
    sys.unraisablehook = lambda args: _log_exception(args.exc_value, "object")
    try:
        yield
    finally:
        threading.excepthook, sys.unraisablehook = hooks
        logging.captureWarnings(False)
        root.removeHandler(handler)


class _LineHandler(logging.Handler):
    """A handler that writes each record as one line."""

    def __init__(self, verb: str, log_format: str) -> None:
        super().__init__(logging.WARNING)
        self._verb, self._as_json = verb, log_format == "json"
        self._stream = standard_error(timeout_s=0.0)  # logging must not wait for a reader

    def emit(self, record: logging.LogRecord) -> None:
        """Write a record; without effect once stderr is closed."""
        error = record.exc_info[1] if record.exc_info else None
        text = " ".join(record.getMessage().split())
        if error is not None:
            text = f"{text}: {type(error).__name__}: {' '.join(str(error).split())}"
        if self._as_json:
            fields: dict[str, Any] = {"logger": record.name}
            if error is not None:
                fields["traceback"] = "".join(traceback.format_exception(error))
            level = _LEVELS.get(record.levelno, "error")
            text = format_json_line(time.time_ns(), level, "program", text, fields)
        else:
            text = f"hubodo {self._verb}: {text}"
        with suppress(OSError, ValueError):
            print(text, file=self._stream, flush=True)


def _log_exception(error: BaseException | None, where: str) -> None:
    if error is not None:
        logging.getLogger("hubodo").error("error in a %s of its own", where, exc_info=error)
