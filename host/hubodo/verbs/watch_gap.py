"""A process that `hubodo record --watch-gap` runs beside the recording to analyse the growing log.

    python -m hubodo.verbs.watch_gap VEHICLE.toml LOG...

It runs at low priority, prints a line for each new finding, and ends when its standard input is closed.
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
    from hubodo.ingest.live.snapshot import Snapshot
from hubodo.ingest.live.snapshot_publisher import SnapshotObserver

# Shortest time between two analyses, and the largest share of the time spent on them.
_MIN_PERIOD_S, _MAX_BUSY_SHARE = 4.0, 0.2
# The same niceness as the jobs of the web page: below a recording, above idle jobs.
_NICENESS = 10


@contextmanager
def run_gap_watch(
    is_wanted: bool, output: Path, vehicle: Path | None
) -> Iterator[Mapping[str, SnapshotObserver]]:
    """Yield a function for `record` to call each second, which returns new findings as events.

    output: log or folder of the recording. Raises InputError without a vehicle.
    """
    if not is_wanted:
        yield {}
        return
    if vehicle is None:
        raise InputError("--watch-gap needs the geometry; give --vehicle TOML")
    lines: queue.SimpleQueue[str] = queue.SimpleQueue()
    command = [sys.executable, "-m", "hubodo.verbs.watch_gap", str(vehicle), str(output)]
    child = subprocess.Popen(
        command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True
    )
    assert child.stdout is not None

    def read_lines(source: Iterator[str]) -> None:
        for line in source:
            lines.put(line.rstrip("\n"))

    def findings(snapshot: Snapshot) -> Iterator[Event]:
        with suppress(queue.Empty):
            while True:
                yield Event(snapshot.t_ns, "gap_seen", "", lines.get_nowait())

    threading.Thread(target=read_lines, args=(iter(child.stdout),), daemon=True).start()
    try:
        yield {"gap": findings}
    finally:
        child.kill()
        child.wait()


def newest_log(output: Path) -> Path | None:
    """Return the log that is being written: the file itself, or the latest of a folder or series."""
    if output.is_file():
        return output
    folder = output if output.is_dir() else output.parent
    stem = "" if output.is_dir() else output.stem
    logs = [path for path in folder.glob(f"{stem}*.mcap") if path.is_file()]
    return max(logs, key=lambda path: path.stat().st_mtime, default=None)


def main() -> int:
    """Run the analysis beside the recording."""
    os.nice(_NICENESS)
    threading.Thread(target=_exit_with_recording, daemon=True).start()
    # Imported here, so that a recording does not wait for the gap analysis to load.
    from hubodo.gap.watch import GapWatch
    from hubodo.log.any_log import read_log
    from hubodo.vehicle import load_vehicle

    watch, output = GapWatch(load_vehicle(Path(sys.argv[1]))), Path(sys.argv[2])
    while True:
        path, started = newest_log(output), time.monotonic()
        # A log that is still being written ends mid-record.
        with suppress(HubodoError, OSError):
            for line in watch.find_new_effects(read_log(path)) if path is not None else []:
                print(line, flush=True)
        time.sleep(max(_MIN_PERIOD_S, (time.monotonic() - started) * (1.0 / _MAX_BUSY_SHARE - 1.0)))


def _exit_with_recording() -> None:
    sys.stdin.buffer.read()
    os._exit(0)


if __name__ == "__main__":
    sys.exit(main())
