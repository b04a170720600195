"""Supply voltage of a node: battery messages in the log, column of its table, CSV export and import."""

import math
from dataclasses import dataclass

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory

from fakes.fake_node import FakeNode
from fakes.script import Script
from generators.fake_drive import RADIUS, TRACK, raw_rows, short_drive
from hubodo.calibration.file import CalibratedEffect, Calibration, NodeCalibration, Quantity
from hubodo.effects import BY_NAME
from hubodo.effects.field import GyroSupply
from hubodo.ingest.live.daemon import record
from hubodo.ingest.live.record_config import RecordConfig
from hubodo.ingest.live.virtual_computer import VirtualComputer
from hubodo.ingest.replay.playback import Playback, recorded_messages, to_messages
from hubodo.log.any_log import read_log
from hubodo.log.csv_folder import read_folder, write_folder
from hubodo.log.recording_reader import open_log, read_recording
from hubodo.log.recording_writer import write_recording
from hubodo.vehicle import NodeMount, Vehicle


@dataclass
class Rode:
    """Logs of a node whose battery voltage drops, and of one without measurement."""

    path: object
    half_ns: int


@pytest.fixture(scope="module")
def rode(tmp_path_factory):
    path, computer = tmp_path_factory.mktemp("rode") / "ride.mcap", VirtualComputer()
    begun_ns = computer.now_ns()
    Script(computer, (4.0, lambda: setattr(left, "battery_mv", 3500)))
    with (
        FakeNode(node_id=1, computer=computer, battery_mv=4100, charge=80) as left,
        FakeNode(node_id=2, computer=computer, battery_mv=0) as right,
    ):
        record(RecordConfig(ports=(left.path, right.path), duration=8.0), path, computer=computer)
    return Rode(path, begun_ns + 4_000_000_000)


def test_other_programs_read_a_battery_of_which_the_unknown_is_unknown(rode):
    with rode.path.open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        decoded = [it.decoded_message for it in reader.iter_decoded_messages(topics=["/left/battery"])]
    assert len(decoded) > 4
    volts = [round(message.voltage, 6) for message in decoded]
    assert volts == sorted(volts, reverse=True) and set(volts) == {4.1, 3.5}
    for message in decoded:
        assert message.header.frame_id == "left"
        assert message.percentage == pytest.approx(0.8) and message.present
        assert math.isnan(message.current) and math.isnan(message.temperature)


def test_a_node_that_measures_no_supply_has_none(rode):
    with open_log(rode.path) as log:
        assert not [message for message in log.messages() if message.topic == "/right/battery"]
    assert "supply" not in read_recording(rode.path).nodes["right"]


def test_its_table_has_the_supply_of_the_time_at_which_it_was_measured(rode):
    recording = read_recording(rode.path)
    left = recording.nodes["left"]
    after = left.t - (rode.half_ns - recording.t_zero_ns) / 1e9
    # Reports arrive twice per second; the voltage is interpolated between them.
    np.testing.assert_allclose(left["supply"][after < -1.1], 4.1, atol=1e-6)
    np.testing.assert_allclose(left["supply"][after > 1.1], 3.5, atol=1e-6)
    assert (after < -1.1).any() and (after > 1.1).any()


def test_the_supply_is_preserved_bit_by_bit_by_csv_export_and_import(rode, tmp_path):
    left = read_recording(rode.path).nodes["left"]
    write_folder(read_recording(rode.path), tmp_path / "csv")
    again = read_folder(tmp_path / "csv")
    assert again.nodes["left"]["supply"].tolist() == left["supply"].tolist()
    assert "supply" not in again.nodes["right"]
    write_recording(again, tmp_path / "again.mcap")
    assert read_recording(tmp_path / "again.mcap").nodes["left"]["supply"].tolist() == left["supply"].tolist()
    with open_log(tmp_path / "again.mcap") as log:
        kinds = {stream.topic: stream.schema for stream in log.streams.values()}
    assert kinds["/left/battery"] == "sensor_msgs/msg/BatteryState" and "/right/battery" not in kinds


def test_a_file_of_numbers_may_have_it(tmp_path):
    rows = "0,0,0,0,0,0,9.8,3.9\n1,0,0,0,0,0,9.8,3.8\n"
    (tmp_path / "gyro.csv").write_text("t,gx,gy,gz,ax,ay,az,supply\n" + rows)
    (table,) = read_log(tmp_path / "gyro.csv").nodes.values()
    assert table["supply"].tolist() == [3.9, 3.8]


def test_live_odometry_corrects_the_supply_effect_and_playback_reproduces_it(tmp_path, monkeypatch):
    monkeypatch.setitem(BY_NAME, "gyro_supply", GyroSupply)
    effect = CalibratedEffect({"z": Quantity(0.1, 1e-3)})
    calibration = Calibration({"left": NodeCalibration({"gyro_supply": effect})})
    vehicle = Vehicle(RADIUS, TRACK, {"left": NodeMount("left", "left")})
    path, computer, drive = tmp_path / "ride.mcap", VirtualComputer(), short_drive(5)
    Script(computer, (4.0, lambda: setattr(left, "battery_mv", 3500)))
    with FakeNode(rows=raw_rows(drive, "left"), computer=computer, battery_mv=4100) as left:
        config = RecordConfig(ports=(f"left={left.path}",), duration=8.0)
        record(config, path, vehicle=vehicle, calibration=calibration, computer=computer)
    again, without = (
        to_messages(playback.odometry_rows(), playback.t_zero_ns)
        for playback in (Playback(path, vehicle=vehicle, calibration=one) for one in (calibration, None))
    )
    assert len(again["/odom"]) > 1000
    assert again == recorded_messages(path) != without
