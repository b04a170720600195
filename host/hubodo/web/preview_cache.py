"""Coarse paths of recordings for the page, computed in a process of low priority and cached beside them."""

from __future__ import annotations

import asyncio
import contextlib
import os
import sys
import tempfile
from pathlib import Path

from hubodo.web.derived_files import DerivedFiles
from hubodo.web.library import RecordingFile

_FILE = "path.json"
_NO_PATH = b'{"topic": "", "points": []}'
_TIME_LIMIT_S = 30.0
_NICENESS = 10


class PreviewCache:
    """Paths by recording, computed one after the other; used only on the server's event loop."""

    def __init__(self, derived: DerivedFiles) -> None:
        self._derived = derived
        self._running_lock = asyncio.Lock()

    async def get(self, entry: RecordingFile) -> bytes:
        """Return the JSON of `path_preview`; without points if the recording cannot be read in time."""
        parts = (*entry.parts, _FILE)
        async with self._running_lock:
            preview = self._derived.read(parts, entry.changed)
            if preview is None:
                preview = await _compute(entry.path)
                with contextlib.suppress(OSError):  # a folder that cannot be written needs no cache
                    self._publish(entry.parts, preview)
        return preview

    def _publish(self, parts: tuple[str, ...], preview: bytes) -> None:
        with tempfile.TemporaryDirectory(prefix="hubodo-") as scratch:
            (Path(scratch) / _FILE).write_bytes(preview)
            self._derived.publish(parts, Path(scratch))


async def _compute(file: Path) -> bytes:
    process = await asyncio.create_subprocess_exec(
        *(sys.executable, "-m", "hubodo.web.path_preview", str(file.absolute())),
        stdin=asyncio.subprocess.DEVNULL,
        stdout=asyncio.subprocess.PIPE,
        stderr=asyncio.subprocess.DEVNULL,
        env={**os.environ, "OPENBLAS_NUM_THREADS": "1"},
    )
    with contextlib.suppress(OSError, AttributeError):
        os.setpriority(os.PRIO_PROCESS, process.pid, _NICENESS)
    try:
        async with asyncio.timeout(_TIME_LIMIT_S):
            printed, _ = await process.communicate()
    except TimeoutError:
        return _NO_PATH
    finally:
        if process.returncode is None:  # too slow, or the server ends
            with contextlib.suppress(ProcessLookupError):
                process.kill()
            await process.wait()
    return printed if process.returncode == 0 else _NO_PATH
