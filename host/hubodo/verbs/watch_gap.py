"""What `hubodo record --watch-gap` runs beside the recording: a process of low priority that reads the log.

    python -m hubodo.verbs.watch_gap VEHICLE.toml LOG...

It reads a log that grows, prints a line for each thing that is new, and ends with its standard input.
"""

from __future__ import annotations

import os
import queue
import subprocess
import sys
import threading
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING

from hubodo.errors import HubodoError, InputError
from hubodo.recording import Event

if TYPE_CHECKING:
    from hubodo.ingest.live.snapshot import Snapshot, Watch

# s between two looks at least; of its time it looks no more than this share.
_AGAIN, _BUSY = 4.0, 0.2
# As the jobs of the page: below a recording, above what only waits for an idle computer.
_NICE = 10


@contextmanager
def watching_gap(wanted: bool, output: Path, vehicle: Path | None) -> Iterator[Mapping[str, Watch]]:
    """Yield what `record` is to call each second, which returns what was found meanwhile as events.

    output: of the recording, a log or a folder. Raises InputError without a vehicle.
    """
    if not wanted:
        yield {}
        return
    if vehicle is None:
        raise InputError("--watch-gap wants the geometry; give --vehicle TOML")
    lines: queue.SimpleQueue[str] = queue.SimpleQueue()
    command = [sys.executable, "-m", "hubodo.verbs.watch_gap", str(vehicle), str(output)]
    child = subprocess.Popen(
        command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True
    )
    assert child.stdout is not None

    def listen(source: Iterator[str]) -> None:
        for line in source:
            lines.put(line.rstrip("\n"))

    def findings(snapshot: Snapshot) -> Iterator[Event]:
        with suppress(queue.Empty):
            while True:
                yield Event(snapshot.t_ns, "gap_seen", "", lines.get_nowait())

    threading.Thread(target=listen, args=(iter(child.stdout),), daemon=True).start()
    try:
        yield {"gap": findings}
    finally:
        child.kill()
        child.wait()


def newest_log(output: Path) -> Path | None:
    """The log that is being written: the file, or of a folder or a series the one that was written last."""
    if output.is_file():
        return output
    folder = output if output.is_dir() else output.parent
    stem = "" if output.is_dir() else output.stem
    logs = [path for path in folder.glob(f"{stem}*.mcap") if path.is_file()]
    return max(logs, key=lambda path: path.stat().st_mtime, default=None)


def main() -> int:
    """The process beside the recording."""
    os.nice(_NICE)
    threading.Thread(target=_end_with_the_recording, daemon=True).start()
    # Not at the top: whoever records need not wait for all of the gap.
    from hubodo.gap.watch import GapWatch
    from hubodo.log.any_log import read_log
    from hubodo.vehicle import load_vehicle

    watch, output = GapWatch(load_vehicle(Path(sys.argv[1]))), Path(sys.argv[2])
    while True:
        path, begun = newest_log(output), time.monotonic()
        # A log that is read while it is written ends in the middle of something.
        with suppress(HubodoError, OSError):
            for line in watch.look(read_log(path)) if path is not None else []:
                print(line, flush=True)
        time.sleep(max(_AGAIN, (time.monotonic() - begun) * (1.0 / _BUSY - 1.0)))


def _end_with_the_recording() -> None:
    sys.stdin.buffer.read()
    os._exit(0)


if __name__ == "__main__":
    sys.exit(main())
