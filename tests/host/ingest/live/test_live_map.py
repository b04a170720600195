"""Map position during a recording: what is forwarded, logged, announced and repeated."""

import numpy as np
import pytest

from hubodo.ingest.live.live_map import LiveMap
from hubodo.ingest.live.localizer import MapPose
from hubodo.ingest.live.localizer_thread import LocalizerOutput
from hubodo.ingest.live.odometry_rows import OdometryRows
from hubodo.log import topics
from hubodo.log.records import EventRecord, LogRecord, Odometry, Transform
from hubodo.recording import Event

ORIGIN = (48.1234567, 11.7654321)


class Localizer:
    """A localizer that records what it receives."""

    def __init__(self) -> None:
        self.items: list[tuple[object, int]] = []

    def put(self, item: object, arrived_ns: int) -> None:
        self.items.append((item, arrived_ns))


class Log:
    """A sink that collects records."""

    def __init__(self) -> None:
        self.records: list[LogRecord] = []

    def write_record(self, record: LogRecord, /) -> None:
        self.records.append(record)

    def events(self) -> list[EventRecord]:
        return [record for record in self.records if isinstance(record, EventRecord)]


class Map:
    """A live map at the host time `now_ns`."""

    def __init__(self, localizer: Localizer | None) -> None:
        self.log, self.notices, self.now_ns = Log(), list[Event](), 1_000_000
        self.map = LiveMap(localizer, self.log, lambda: self.now_ns, self.notices)  # type: ignore[arg-type]


def _pose(t_ns: int) -> MapPose:
    position, one = np.array([[3.0, -4.0]]), np.ones(1)
    row = OdometryRows(np.array([t_ns]), position, one, one, one, np.eye(3)[None])
    return MapPose(row, position, one, ORIGIN)


def test_without_a_localizer_nothing_is_active() -> None:
    idle = Map(None)
    idle.map.put([object()], 5)  # type: ignore[list-item]
    assert not idle.map.is_active and idle.map.latest is None and idle.log.records == []


def test_items_are_forwarded_in_order_with_their_arrival() -> None:
    localizer = Localizer()
    live = Map(localizer)
    live.map.put(["fix", "pose"], 7)  # type: ignore[list-item]
    assert live.map.is_active and localizer.items == [("fix", 7), ("pose", 7)]


def test_the_first_pose_announces_the_origin_once_and_each_one_is_logged() -> None:
    live = Map(Localizer())
    for t_ns in (100, 200):
        live.map.handle(LocalizerOutput(_pose(t_ns), (), 400_000))
    (event,) = live.log.events()
    assert (event.event.kind, event.event.t_ns) == ("started", 100)
    assert event.event.data == {"latitude_deg": ORIGIN[0], "longitude_deg": ORIGIN[1]}
    assert "latitude 48.1234567, longitude 11.7654321 degrees" in event.event.text
    poses = [record for record in live.log.records if isinstance(record, Odometry)]
    assert [int(pose.t_ns[0]) for pose in poses] == [100, 200]
    assert {pose.topic for pose in poses} == {topics.ODOM_MAP}
    assert sum(isinstance(record, Transform) for record in live.log.records) == 2
    assert live.map.pose_count == 2 and live.map.latest is not None and live.map.latest.t_ns[0] == 200
    # 1.0 ms - 0.4 ms.
    assert live.map.latency.as_json()["latency_worst"] == pytest.approx(0.6e-3)


def test_a_warning_is_shown_and_logged_and_is_no_pose() -> None:
    live = Map(Localizer())
    live.map.handle(LocalizerOutput(None, ("3 fixes far from the drive",), 0))
    assert [notice.text for notice in live.notices] == ["map: 3 fixes far from the drive"]
    (event,) = live.log.events()
    assert (event.event.kind, event.event.source, event.event.t_ns) == ("warning", "map", live.now_ns)
    assert live.map.pose_count == 0


def test_another_log_starts_with_the_origin_if_there_is_one() -> None:
    live = Map(Localizer())
    live.map.repeat_origin(5)
    assert live.log.records == []
    live.map.handle(LocalizerOutput(_pose(100), (), 0))
    live.log.records.clear()
    live.map.repeat_origin(2_000_000)
    (event,) = live.log.events()
    # The time of the origin, logged at the start of that log.
    assert (event.event.t_ns, event.t_log_ns) == (100, 2_000_000)
