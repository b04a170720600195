"""What libraries log, warn of, or raise in threads: one line each on stderr, as text or as JSON."""

from __future__ import annotations

import logging
import sys
import threading
import time
import traceback
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import Any

from hubodo.ingest.live.patient_stream import standard_error
from hubodo.ingest.live.view import json_line

_LEVELS = {logging.WARNING: "warning", logging.ERROR: "error", logging.CRITICAL: "error"}


@contextmanager
def program_log(verb: str, log_format: str = "text") -> Iterator[None]:
    """Show log records from WARNING on, warnings and exceptions of threads inside the block.

    Parameters
    ----------
    verb : stands before each line of text.
    log_format : "text", a line without a traceback; "json", an object with the traceback among its fields.
    """
    root, handler = logging.getLogger(), _LineHandler(verb, log_format)
    hooks = threading.excepthook, sys.unraisablehook
    root.addHandler(handler)
    logging.captureWarnings(True)
    threading.excepthook = lambda args: _log_raised(args.exc_value, "thread")
    sys.unraisablehook = lambda args: _log_raised(args.exc_value, "object")
    try:
        yield
    finally:
        threading.excepthook, sys.unraisablehook = hooks
        logging.captureWarnings(False)
        root.removeHandler(handler)


class _LineHandler(logging.Handler):
    """Writes a record as one line."""

    def __init__(self, verb: str, log_format: str) -> None:
        super().__init__(logging.WARNING)
        self._verb, self._as_json = verb, log_format == "json"
        self._stream = standard_error(patience_s=0.0)  # whoever logs must not wait for a reader

    def emit(self, record: logging.LogRecord) -> None:
        """See `logging.Handler`; where stderr is gone, nobody is left to read it."""
        error = record.exc_info[1] if record.exc_info else None
        text = " ".join(record.getMessage().split())
        if error is not None:
            text = f"{text}: {type(error).__name__}: {' '.join(str(error).split())}"
        if self._as_json:
            fields: dict[str, Any] = {"logger": record.name}
            if error is not None:
                fields["traceback"] = "".join(traceback.format_exception(error))
            level = _LEVELS.get(record.levelno, "error")
            text = json_line(time.time_ns(), level, "program", text, fields)
        else:
            text = f"hubodo {self._verb}: {text}"
        with suppress(OSError, ValueError):
            print(text, file=self._stream, flush=True)


def _log_raised(error: BaseException | None, where: str) -> None:
    if error is not None:
        logging.getLogger("hubodo").error("error in a %s of its own", where, exc_info=error)
