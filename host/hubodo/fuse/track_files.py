"""A track as a file of other programs: TUM and KITTI for evaluation, GPX, KML and GeoJSON for maps."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from xml.sax.saxutils import escape

import numpy as np

from hubodo.arrays import Array
from hubodo.errors import InputError
from hubodo.fuse.fused_recording import RESULT_FILES
from hubodo.fuse.projection import make_local_frame
from hubodo.log.csv_table import read_table
from hubodo.recording import Recording
from hubodo.safe_text import json_text
from hubodo.units import NS_PER_S


@dataclass(frozen=True)
class ExportedTrack:
    """A track with the values that files of other programs need.

    Attributes
    ----------
    name
        Name for maps.
    t
        (N,) s since 1970, or since the start of the log if its time is unknown.
    x, y, heading
        (N,) m, m, rad.
    origin_deg
        Latitude and longitude of x = y = 0, with x to the east; None if unknown.
    """

    name: str
    t: Array
    x: Array
    y: Array
    heading: Array
    origin_deg: tuple[float, float] | None = None

    def positions_deg(self) -> tuple[Sequence[float], Sequence[float]]:
        """Return latitudes and longitudes (N,), degrees; raise InputError if the origin is unknown."""
        if self.origin_deg is None:
            raise InputError(
                f"{self.name}: its position on Earth is unknown; fuse a log with GNSS, or add its start: "
                "--origin LATITUDE LONGITUDE"
            )
        latitude, longitude = make_local_frame(*self.origin_deg).to_geodetic(self.x, self.y)
        return latitude.tolist(), longitude.tolist()

    def times_text(self) -> list[str]:
        """Return the times as ISO 8601 in UTC, with milliseconds."""
        times = (datetime.fromtimestamp(t, UTC) for t in self.t.tolist())
        return [time.isoformat(timespec="milliseconds").replace("+00:00", "Z") for time in times]


def is_fused(path: Path) -> bool:
    """Return True for a folder with the results of `hubodo fuse`."""
    return all((path / name).is_file() for name in RESULT_FILES)


def read_fused_track(folder: Path, origin_deg: tuple[float, float] | None = None) -> ExportedTrack:
    """Return the track in the results of `hubodo fuse`.

    origin_deg: latitude and longitude of the start, used if the results hold none.

    Raises InputError if they are not readable.
    """
    table_path, report_path = (folder / name for name in RESULT_FILES)
    table = read_table(table_path, ("t", "x", "y", "heading")).table
    try:
        report = json.loads(report_path.read_text("utf-8"))
        t_zero_ns = int(report.get("t_zero_ns", 0))
        origin = report.get("graph", {}).get("origin")
        if origin is not None and origin_deg is None:
            origin_deg = float(origin["latitude_deg"]), float(origin["longitude_deg"])
    except (OSError, ValueError, TypeError, KeyError, AttributeError) as error:
        raise InputError(
            f"{report_path}: is no result of hubodo fuse ({error}); fuse the log again"
        ) from None
    t = t_zero_ns / NS_PER_S + table.t
    return ExportedTrack(folder.name, t, table["x"], table["y"], table["heading"], origin_deg)


def live_track(
    recording: Recording, name: str, origin_deg: tuple[float, float] | None = None
) -> ExportedTrack:
    """Return the odometry that was recorded live; raise InputError if there is none."""
    table = recording.odometry
    if table is None or not len(table):
        raise InputError(
            f"{name}: holds no live odometry; export the folder of `hubodo fuse {name} --vehicle TOML -o OUT`"
        )
    t = recording.t_zero_ns / NS_PER_S + table.t
    return ExportedTrack(Path(name).stem, t, table["x"], table["y"], table["heading"], origin_deg)


def format_tum(track: ExportedTrack) -> str:
    """Return `t x y z qx qy qz qw` per line, as evo and the TUM benchmark read it."""
    half = 0.5 * track.heading
    columns = (track.t, track.x, track.y, np.sin(half), np.cos(half))
    rows = zip(*(column.tolist() for column in columns), strict=True)
    return "".join(f"{t:.9f} {x:.9f} {y:.9f} 0 0 0 {qz:.12f} {qw:.12f}\n" for t, x, y, qz, qw in rows)


def format_kitti(track: ExportedTrack) -> str:
    """Return the upper three rows of each pose's matrix per line; x forward, y left, z up; no times."""
    columns = (track.x, track.y, np.cos(track.heading), np.sin(track.heading))
    rows = zip(*(column.tolist() for column in columns), strict=True)
    return "".join(
        f"{c:.12f} {-s:.12f} 0 {x:.9f} {s:.12f} {c:.12f} 0 {y:.9f} 0 0 1 0\n" for x, y, c, s in rows
    )


def format_gpx(track: ExportedTrack) -> str:
    """Return GPX 1.1 with times."""
    rows = zip(*track.positions_deg(), track.times_text(), strict=True)
    points = "".join(
        f'<trkpt lat="{latitude:.9f}" lon="{longitude:.9f}"><time>{time}</time></trkpt>\n'
        for latitude, longitude, time in rows
    )
    return (
        '<?xml version="1.0" encoding="UTF-8"?>\n'
        '<gpx version="1.1" creator="hubodo" xmlns="http://www.topografix.com/GPX/1/1">\n'
        f"<trk><name>{escape(track.name)}</name><trkseg>\n{points}</trkseg></trk>\n</gpx>\n"
    )


def format_kml(track: ExportedTrack) -> str:
    """Return KML 2.2 with one line; it has no times."""
    latitude, longitude = track.positions_deg()
    points = "\n".join(f"{lon:.9f},{lat:.9f}" for lat, lon in zip(latitude, longitude, strict=True))
    return (
        '<?xml version="1.0" encoding="UTF-8"?>\n'
        '<kml xmlns="http://www.opengis.net/kml/2.2"><Document><Placemark>\n'
        f"<name>{escape(track.name)}</name><LineString><tessellate>1</tessellate><coordinates>\n{points}\n"
        "</coordinates></LineString></Placemark></Document></kml>\n"
    )


def format_geojson(track: ExportedTrack) -> str:
    """Return GeoJSON (RFC 7946) with one line; `coordTimes` holds the times, as in togeojson."""
    latitude, longitude = track.positions_deg()
    points = [[round(lon, 9), round(lat, 9)] for lat, lon in zip(latitude, longitude, strict=True)]
    feature = {
        "type": "Feature",
        "properties": {"name": track.name, "coordTimes": track.times_text()},
        "geometry": {"type": "LineString", "coordinates": points},
    }
    return json_text({"type": "FeatureCollection", "features": [feature]}) + "\n"


TRACK_WRITERS: Mapping[str, Callable[[ExportedTrack], str]] = {
    "tum": format_tum,
    "kitti": format_kitti,
    "gpx": format_gpx,
    "kml": format_kml,
    "geojson": format_geojson,
}
"""Functions that return the text of a file, by the name of the format."""
