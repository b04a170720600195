"""Read logs in any format: the content of a file decides, not its name."""

import shutil

import numpy as np
import pytest

from hubodo.errors import InputError
from hubodo.log.any_log import find_mcap_file, is_hubodo_mcap, is_rosbag, open_as_mcap, open_source, read_log
from hubodo.log.number_recording import InputFormat
from hubodo.log.recording_writer import write_recording
from hubodo.recording import NODE_COLUMNS, Recording, Table


@pytest.fixture
def log(tmp_path):
    table = Table({name: np.arange(5.0) for name in NODE_COLUMNS})
    write_recording(Recording({"left": table}), tmp_path / "left.csv")  # an MCAP file, despite its name
    return tmp_path / "left.csv"


def test_an_mcap_file_is_recognised_whatever_its_name(log):
    assert find_mcap_file(log) == log and is_hubodo_mcap(log) and not is_rosbag(log)
    assert list(read_log(log).nodes) == ["left"]


def test_a_folder_with_csv_files_beside_a_log_is_a_csv_folder(log, tmp_path):
    (tmp_path / "right.mcap").write_bytes(log.read_bytes())
    assert not is_rosbag(tmp_path)
    with open_source(tmp_path) as source:
        assert source is None


def test_a_rosbag2_folder_without_messages_is_refused(tmp_path):
    (tmp_path / "metadata.yaml").write_text("rosbag2_bagfile_information:\n")
    assert is_rosbag(tmp_path)
    with pytest.raises(InputError, match=r"without an \.mcap or \.db3 file"):
        find_mcap_file(tmp_path)


def test_an_empty_table_is_omitted_and_reported_unless_requested(tmp_path):
    node = Table({name: np.arange(5.0) for name in NODE_COLUMNS})
    empty = Table({name: np.zeros(0) for name in ("t", "latitude_deg", "longitude_deg", "altitude")})
    write_recording(Recording({"left": node}, gnss=empty), tmp_path / "log.mcap")
    recording = read_log(tmp_path / "log.mcap")
    assert recording.gnss is None and "gnss has no rows" in recording.warnings[0]
    assert read_log(tmp_path / "log.mcap", keep_empty=True).gnss is not None


def test_a_table_without_a_row_of_numbers_is_named_as_such(tmp_path):
    for name, content in (("header.csv", b"t,gx,gy,gz,ax,ay,az\n"), ("noise.csv", bytes(range(128, 256)))):
        (tmp_path / name).write_bytes(content)
        with pytest.raises(InputError, match=rf"{name}: holds no table of numbers"):
            read_log(tmp_path / name)


def test_a_sample_rate_is_refused_for_messages_that_have_times(log):
    for read in (read_log, lambda path, input_format: open_as_mcap(path, input_format).__enter__()):
        with pytest.raises(InputError, match="its messages have times; omit --rate"):
            read(log, input_format=InputFormat(rate=100.0))


def test_a_folder_of_several_logs_and_a_result_of_fuse_are_named_as_such(log, tmp_path):
    logs, result = tmp_path / "logs", tmp_path / "result"
    logs.mkdir()
    for name in ("a.mcap", "b.mcap"):
        shutil.copy(log, logs / name)
    with pytest.raises(InputError, match=r"logs: holds several logs; name one, such as .*a\.mcap"):
        read_log(logs)
    result.mkdir()
    (result / "fuse.json").write_text("{}")
    (result / "track.csv").write_text("t,x,y\n0,0,0\n")
    with pytest.raises(InputError, match="holds the result of `hubodo fuse`"):
        read_log(result)
