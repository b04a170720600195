"""Reading complete, truncated, damaged and foreign logs: readable messages are returned, losses reported."""

import random
import resource
import struct
import subprocess
import sys
import textwrap
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from mcap.writer import CompressionType, Writer

from hubodo.errors import LogError
from hubodo.log import cdr_layouts, ros2
from hubodo.log.hubodo_messages import decode_bytes_message
from hubodo.log.log_writer import LogWriter
from hubodo.log.recording_reader import open_log, read_recording
from hubodo.log.recording_writer import write_recording
from hubodo.log.recover import recover_log
from hubodo.log.summary import summarise
from hubodo.recording import NODE_COLUMNS, Recording, Table

N = 400


def small_log(path: Path, compression="zstd", chunk_bytes: int = 20_000) -> Path:
    """Write two nodes at 100 Hz for 4 s, in a dozen chunks or more."""
    with LogWriter(path, t_zero_ns=0, compression=compression, chunk_bytes=chunk_bytes, clock=None) as log:
        for first in range(0, N, 8):
            i = np.arange(first, first + 8)
            rows = np.column_stack([i, i, i]).astype(float)
            for node in ("left", "right"):
                log.write_imu(node, i * 10_000_000, i * 10_000_000 + 1000, rows, -rows)
    return path


@pytest.fixture(scope="module")
def complete_log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return small_log(tmp_path_factory.mktemp("log") / "whole.mcap")


def assert_true_rows(path: Path) -> int:
    """Assert that every row read was written; return their number."""
    nodes = read_recording(path).nodes
    for table in nodes.values():
        i = np.rint(table.t * 100)
        assert (np.abs(table.t * 100 - i) < 1e-9).all()
        assert (table.gyro == i[:, None]).all()
        assert (table.accel == -i[:, None]).all()
    return sum(map(len, nodes.values()))


def test_a_truncated_log_is_read_up_to_the_cut_and_the_loss_reported(
    complete_log: Path, tmp_path: Path
) -> None:
    data = complete_log.read_bytes()
    with open_log(complete_log) as log:
        places = [(place.offset, place.offset + place.length) for place in log.scan.chunks]
    assert len(places) > 10
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(data[: places[5][1] - 1])
    recording = read_recording(cut)
    (warning,) = recording.warnings
    n_rows = sum(map(len, recording.nodes.values()))
    assert f"was not closed: {n_rows} messages are kept, {places[5][1] - 1 - places[5][0]} bytes" in warning
    assert assert_true_rows(cut) == n_rows > 250


def test_a_log_that_was_never_closed_is_read_completely(tmp_path: Path) -> None:
    log = LogWriter(tmp_path / "log.mcap", clock=None)
    log.write_raw_frame("usb0", 5, b"x")
    log.flush()
    with open_log(tmp_path / "log.mcap") as read:
        assert [decode_bytes_message("cdr", m.data) for m in read.messages()] == [b"x"]
        assert "was not closed: 1 messages are kept, 0 bytes" in " ".join(
            [*read.chunks()] and read.warnings()
        )
    log.close()


@pytest.mark.parametrize("compression", ["zstd", "lz4", "none"])
def test_a_flipped_bit_loses_its_chunk_which_is_reported_with_its_time(compression, tmp_path: Path) -> None:
    path = small_log(tmp_path / "log.mcap", compression)
    with open_log(path) as log:
        place = log.scan.chunks[3]
        lost = len([m for m in log.messages() if place.start_ns <= m.log_time <= place.end_ns])
    data = bytearray(path.read_bytes())
    data[place.data_offset + place.data_size // 2] ^= 4
    path.write_bytes(data)
    recording = read_recording(path)
    (warning,) = recording.warnings
    assert f"(t = {place.start_ns / 1e9:.3f} s to {place.end_ns / 1e9:.3f} s): chunk" in warning
    assert 0 < 2 * N - assert_true_rows(path) <= lost
    with open_log(path) as log:
        assert len(list(log.messages())) == assert_true_rows(path)


def test_a_flipped_bit_creates_no_row_and_loses_at_most_its_neighbourhood(
    complete_log: Path, tmp_path: Path
) -> None:
    seed, data, path = 11, complete_log.read_bytes(), tmp_path / "flipped.mcap"
    rng = random.Random(seed)
    for _ in range(150):
        at, bit = rng.randrange(8, len(data)), rng.randrange(8)
        flipped = bytearray(data)
        flipped[at] ^= 1 << bit
        path.write_bytes(flipped)
        assert assert_true_rows(path) >= 2 * N - 140, f"byte {at} bit {bit}, seed {seed}"


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        (b"", "is empty"),
        (b"\x89MCAP1\r\n" + bytes(100), "is not an MCAP file"),
        (b"t,gx,gy,gz,ax,ay,az\n0,1,2,3,4,5,6\n", "is not an MCAP file"),
        (b"\x89MC", "is not an MCAP file"),
    ],
)
def test_a_file_that_is_not_a_log_is_refused_in_one_line(content: bytes, reason: str, tmp_path: Path) -> None:
    path = tmp_path / "log.mcap"
    path.write_bytes(content)
    with pytest.raises(LogError, match=reason) as caught:
        read_recording(path)
    assert "\n" not in str(caught.value)


def test_a_missing_file_and_a_folder_are_refused(tmp_path: Path) -> None:
    with pytest.raises(LogError, match="No such file"):
        open_log(tmp_path / "absent.mcap")
    with pytest.raises(LogError, match="is a folder"):
        open_log(tmp_path)


@given(tail=st.binary(max_size=300))
def test_random_bytes_after_the_magic_cause_no_crash(tail: bytes, tmp_path_factory) -> None:
    path = tmp_path_factory.getbasetemp() / "anything.mcap"
    path.write_bytes(b"\x89MCAP0\r\n" + tail)
    assert read_recording(path).nodes == {}


HUGE = {
    "record": lambda d, p: d[: p.offset + 1] + struct.pack("<Q", 1 << 62) + d[p.offset + 9 :],
    "chunk size": lambda d, p: d[: p.offset + 25] + struct.pack("<Q", 1 << 62) + d[p.offset + 33 :],
    "data size": lambda d, p: d[: p.data_offset - 8] + struct.pack("<Q", 1 << 62) + d[p.data_offset :],
}


@pytest.mark.parametrize("kind", HUGE)
def test_false_lengths_allocate_no_memory(kind: str, tmp_path: Path) -> None:
    path = small_log(tmp_path / "log.mcap")
    with open_log(path) as log:
        place = log.scan.chunks[2]
    path.write_bytes(HUGE[kind](path.read_bytes(), place))
    program = textwrap.dedent(f"""
        import resource; from pathlib import Path; from hubodo.log.recording_reader import read_recording
        resource.setrlimit(resource.RLIMIT_AS, ({3 << 30}, {3 << 30}))
        recording = read_recording(Path({str(path)!r}))
        assert len(recording.warnings) == 1, recording.warnings
        print(sum(map(len, recording.nodes.values())))
    """)
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, timeout=300, check=False,
        env={"OPENBLAS_NUM_THREADS": "1", "PYTHONPATH": ":".join(sys.path)},
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert int(done.stdout) > 600


@pytest.mark.parametrize("chunked", [True, False])
@pytest.mark.parametrize("compression", [CompressionType.ZSTD, CompressionType.LZ4, CompressionType.NONE])
def test_logs_of_other_writers_are_read_by_topic_name(chunked: bool, compression, tmp_path: Path) -> None:
    path = tmp_path / "foreign.mcap"
    layout = cdr_layouts.stamped_layout(ros2.IMU, "imu_link")
    with path.open("wb") as stream:
        writer = Writer(stream, compression=compression, use_chunking=chunked, chunk_size=5000)
        writer.start("ros2", "somebody else")
        schema = writer.register_schema(ros2.IMU, "ros2msg", ros2.definition(ros2.IMU).encode())
        names = ["/imu/data_raw", "/vehicle/rear/imu", "/imu"]
        ids = [writer.register_channel(name, "cdr", schema) for name in names]
        for i in range(200):
            record = np.zeros(1, layout.dtype)
            record[0] = layout.template
            record["header.stamp.sec"], record["header.stamp.nanosec"] = 100 + i // 100, i % 100 * 10_000_000
            record["angular_velocity"] = i
            for id in ids:
                writer.add_message(id, i, record.tobytes(), i)
        writer.finish()
    recording = read_recording(path)
    assert list(recording.nodes) == ["imu_data_raw", "vehicle_rear", "imu"]
    assert recording.warnings == ()
    assert recording.t_zero_ns == 100 * 10**9
    for table in recording.nodes.values():
        assert table.t.tolist() == [i / 100 for i in range(200)]
        assert table["gz"].tolist() == list(range(200))


def test_messages_of_changing_frame_names_are_all_decoded_in_order(tmp_path: Path) -> None:
    path, names = tmp_path / "log.mcap", ["a", "bb", "abcdefghi", "bb", "é", ""] * 20
    with LogWriter(path, t_zero_ns=0) as log:
        channel = log.add_ros2_channel("/x/imu", ros2.IMU)
        for i, name in enumerate(names):
            record = np.zeros(1, cdr_layouts.stamped_layout(ros2.IMU, name).dtype)
            record[0] = cdr_layouts.stamped_layout(ros2.IMU, name).template
            record["header.stamp.nanosec"], record["linear_acceleration"] = i + 1, i
            log.write(channel, i, i, record.tobytes())
            if i % 10 == 0:
                log.write(channel, i, i, b"\0\1\0\0garbage")
    recording = read_recording(path)
    assert recording.nodes["x"]["az"].tolist() == list(range(120))
    assert "12 messages of /x/imu do not match" in recording.warnings[0]


def test_rows_with_a_repeated_time_are_left_out_and_counted(tmp_path: Path) -> None:
    with LogWriter(tmp_path / "log.mcap", t_zero_ns=0) as log:
        t = [10, 20, 20, 15, 30]
        log.write_imu("left", t, t, np.arange(15.0).reshape(5, 3), np.zeros((5, 3)))
    recording = read_recording(tmp_path / "log.mcap")
    assert recording.nodes["left"].t.tolist() == [1e-8, 1.5e-8, 2e-8, 3e-8]
    assert recording.nodes["left"]["gx"].tolist() == [0, 9, 3, 12]
    assert "1 messages of /left/imu repeat the time of another" in recording.warnings[0]


@pytest.mark.parametrize("window", [(None, None), (50, 150), (0, 1), (199, None), (None, 3)])
def test_messages_of_overlapping_chunks_are_sorted_by_log_time(window, tmp_path: Path) -> None:
    rng = np.random.default_rng(4)
    with LogWriter(tmp_path / "log.mcap", chunk_bytes=500, clock=None) as log:
        for t in rng.integers(0, 200, 1000).tolist():
            log.write_raw_frame("usb0" if t % 2 else "usb1", t, bytes([t]))
    start, end = window
    with open_log(tmp_path / "log.mcap") as read:
        times = [m.log_time for m in read.messages(start=start, end=end)]
        odd = [m.log_time for m in read.messages(["/hubodo/raw/usb0"], start, end)]
    rng = np.random.default_rng(4)
    low, high = start or 0, 200 if end is None else end
    expected = sorted(t for t in rng.integers(0, 200, 1000).tolist() if low <= t < high)
    assert times == expected
    assert odd == [t for t in expected if t % 2]


def test_messages_with_equal_times_keep_the_order_of_the_file(tmp_path: Path) -> None:
    """Frames with equal times keep the order of the file, even if a later chunk starts earlier."""
    path = tmp_path / "log.mcap"
    first = b"first" + bytes(200)  # fills a chunk
    with path.open("wb") as stream:
        writer = Writer(stream, chunk_size=200, compression=CompressionType.NONE)
        writer.start()
        raw, late = (writer.register_channel(topic, "x", 0) for topic in ("/raw", "/late"))
        for channel, t, data in (
            (raw, 5, first),
            (late, 3, b"older"),
            (raw, 5, b"second"),
            (raw, 5, b"third"),
        ):
            writer.add_message(channel, t, data, t)
        writer.finish()
    with open_log(path) as log:
        assert [place.start_ns for place in log.scan.chunks] == [5, 3]
        assert [m.data for m in log.messages()] == [b"older", first, b"second", b"third"]


def test_iteration_holds_few_chunks_in_memory(tmp_path: Path) -> None:
    with LogWriter(tmp_path / "log.mcap", compression="zstd", clock=None) as log:
        channel = log.add_channel("/x", "", "", b"", "json")
        for t in range(200_000):
            log.write(channel, t, t, bytes(1000))
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    with open_log(tmp_path / "log.mcap") as read:
        count = sum(1 for _ in read.messages())
    grown = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before
    assert count == 200_000
    assert grown < 60_000, f"{grown} kB for 200 MB of messages"


def test_a_randomly_damaged_log_is_read_or_refused_without_a_crash(tmp_path: Path) -> None:
    seed = 1
    rng = random.Random(seed)
    complete_log = tmp_path / "whole.mcap"
    t = np.arange(40) / 7 + 1e-11
    node = Table({name: t if name == "t" else np.ones(40) for name in (*NODE_COLUMNS, "temperature", "own")})
    table = Table({"t": t, "angle": t, "moving": t})
    write_recording(Recording({"left": node}, table=table), complete_log, compression="none")
    data = complete_log.read_bytes()
    for attempt in range(150):
        mangled = bytearray(data)
        for _ in range(rng.randint(1, 12)):
            at, kind = rng.randrange(len(mangled)), rng.random()
            if kind < 0.5:
                mangled[at] = rng.randrange(256)
            elif kind < 0.7:
                del mangled[at : at + rng.randint(1, 50)]
            elif kind < 0.9:
                mangled[at:at] = rng.randbytes(rng.randint(1, 50))
            else:
                del mangled[max(10, at) :]
        path, out = tmp_path / "mangled.mcap", tmp_path / "out.mcap"
        path.write_bytes(mangled)
        for read, more in ((read_recording, ()), (summarise, ()), (recover_log, (out,))):
            try:
                read(path, *more)
            except LogError:
                continue
            except Exception as error:
                raise AssertionError(f"{read}, attempt {attempt}, seed {seed}") from error
        out.unlink(missing_ok=True)
