"""The recipe "add a record of the log" of CONTRIBUTING.md, carried out in a copy of the package."""

import json
from pathlib import Path

import pytest
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory

from package_copy import PackageCopy

RECORD = '''@dataclass(frozen=True, slots=True, eq=False)
class TyrePressure:
    """Pressure of a wheel's tyre above that of the air; pressure: (n,) Pa."""

    node: str
    t_ns: ArrayLike
    t_log_ns: int
    pressure: ArrayLike

    def write_to(self, log: LogWriter) -> None:
        """Write the pressures."""
        log.write_columns(f"tyre_pressure/{self.node}", self.t_ns, self.t_log_ns, {"pressure": self.pressure})


LogRecord = (
'''
WRITE = """
import sys
from pathlib import Path
from hubodo.ingest.live.bulkheads import Bulkheads
from hubodo.ingest.live.tee_sink import TeeSink
from hubodo.log.log_writer import LogWriter
from hubodo.log.records import TyrePressure, stream_key

records = [TyrePressure(node, [10, 20], 30, [2.5e5, 2.4e5 + k]) for k, node in enumerate(("left", "right"))]
received = []
with LogWriter(Path(sys.argv[1]), t_zero_ns=0, clock=None) as log:
    sink = TeeSink(log, {"page": received.append}, Bulkheads(lambda: 0))
    for record in records:
        sink.write_record(record)
assert received == records
assert stream_key(records[0]) != stream_key(records[1])
"""
TESTS = ("host/log/test_log_writer.py", "host/log/test_log_series.py", "host/ingest/live/test_tee_sink.py")
"""Tests of the parts through which records pass."""


@pytest.fixture(scope="module")
def copy(tmp_path_factory: pytest.TempPathFactory) -> PackageCopy:
    """A copy of the package with one more kind of record: one class and one line."""
    copy = PackageCopy(tmp_path_factory.mktemp("copy"))
    copy.replace(
        "log/records.py",
        ("LogRecord = (\n", RECORD),
        ("    | Metadata\n", "    | Metadata\n    | TyrePressure\n"),
    )
    return copy


def test_an_added_record_is_written_passed_on_and_read_by_other_programs(
    copy: PackageCopy, tmp_path: Path
) -> None:
    path = tmp_path / "log.mcap"
    copy.run("-c", WRITE, path)
    with path.open("rb") as stream:
        rows = [
            (
                channel.topic,
                message.log_time,
                message.publish_time,
                list(decoded.data),
                channel.metadata["columns"],
            )
            for _, channel, message, decoded in make_reader(
                stream, decoder_factories=[DecoderFactory()]
            ).iter_decoded_messages()
        ]
    assert sorted(rows) == [
        (f"/hubodo/columns/tyre_pressure/{node}", 30, t_ns, [pressure], '["pressure"]')
        for node, k in (("left", 0), ("right", 1))
        for t_ns, pressure in ((10, 2.5e5), (20, 2.4e5 + k))
    ]
    streams = json.loads(copy.run("-m", "hubodo", "info", path, "--json"))["streams"]
    assert [(stream["topic"], stream["messages"]) for stream in streams] == [
        (f"/hubodo/columns/tyre_pressure/{node}", 2) for node in ("left", "right")
    ]


@pytest.mark.repeat
def test_no_test_of_the_writers_fails_for_an_added_record(copy: PackageCopy) -> None:
    assert copy.run_tests(*TESTS)
