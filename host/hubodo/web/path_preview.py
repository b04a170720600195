"""A coarse path of a recording: `python -m hubodo.web.path_preview LOG.mcap` prints it as JSON.

The server runs this in a process of its own, because decompression would delay a recording in the server's
process. Only a bounded number of chunks is read, so a log of a day takes as long as one of an hour.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hubodo.errors import HubodoError
from hubodo.log import ros2, topics
from hubodo.log.decode import ChannelDecoder, normalise_type_name
from hubodo.log.logfile import Log, open_log
from hubodo.log.role_tables import gnss_columns
from hubodo.log.source import Stream
from hubodo.safe_text import json_text
from hubodo.web.local_plane import local_east_north

_MAX_CHUNKS = 120
_PREVIEW_POINTS = 300
_MIN_EXTENT = 0.1  # m; less is a sensor at rest
_PREFERRED_TOPICS = (topics.ODOM_MAP, topics.ODOM, topics.GNSS_FIX)
_PATH_TYPES = (ros2.ODOMETRY, ros2.NAV_SAT_FIX)


def preview_path(file: Path) -> dict[str, Any]:
    """Return the `topic` and some hundred `points` [x, y] in m; no points if the log has no path.

    Raises
    ------
    LogError
        If the file is no log.
    """
    with open_log(file) as log:
        for stream in _path_streams(log):
            points = _read_positions(log, stream)
            if len(points) > 1 and np.ptp(points, axis=0).max() > _MIN_EXTENT:
                return {"topic": stream.topic, "points": points.round(2).tolist()}
    return {"topic": "", "points": []}


def _path_streams(log: Log) -> list[Stream]:
    """Return the streams with positions: hubodo's own odometry first, then GNSS, then those of others."""
    streams = [stream for stream in log.streams.values() if normalise_type_name(stream.schema) in _PATH_TYPES]
    ranks = {topic: rank for rank, topic in enumerate(_PREFERRED_TOPICS)}
    return sorted(streams, key=lambda stream: (ranks.get(stream.topic, len(ranks)), stream.topic))


def _read_positions(log: Log, stream: Stream) -> NDArray[np.float64]:
    """Return positions (n, 2) of a stream, spread over the log, m."""
    kind = normalise_type_name(stream.schema)
    decoder = ChannelDecoder(kind)
    per_chunk = max(2, _PREVIEW_POINTS // max(1, min(_MAX_CHUNKS, len(log.scan.chunks))))
    for messages in log.chunks(at_most=_MAX_CHUNKS):
        indices = np.flatnonzero(messages.headers["channel"] == stream.id)
        spread = np.linspace(0, len(indices) - 1, min(len(indices), per_chunk)).astype(np.intp)
        decoder.feed(messages, indices[spread])
    rows = decoder.rows()
    if not len(rows):
        return np.empty((0, 2))
    if kind == ros2.ODOMETRY:
        points = rows.values["pose.pose.position"][:, :2]
    else:
        _, fixes = gnss_columns(rows)
        places = list(zip(fixes["latitude_deg"].tolist(), fixes["longitude_deg"].tolist(), strict=True))
        points = np.array([local_east_north(*place, places[0]) for place in places]).reshape(-1, 2)
    return points[np.isfinite(points).all(axis=1)]


def main(arguments: list[str]) -> int:
    """Print the path of the log that is named by the only argument."""
    try:
        print(json_text(preview_path(Path(arguments[0]))))
    except (HubodoError, OSError) as error:
        print(error, file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
