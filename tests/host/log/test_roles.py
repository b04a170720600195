"""Logs of other programs with their topics and times: reading them, and running verbs on them."""

import json
import shutil
import sqlite3
from pathlib import Path

import numpy as np
import pytest

from foreign_logs import MODEL, RADIUS, RATE, T0, TOPICS, WRITERS, drive, messages, write
from hubodo.errors import InputError
from hubodo.log import ros2
from hubodo.log.any_log import read_log
from hubodo.log.number_recording import InputFormat
from hubodo.log.roles import TopicCandidate, TopicSelection, assign_roles, node_name_of_topic
from in_process import hubodo

VEHICLE = (
    MODEL.partition("[imu]")[0] + "[nodes.left]" + MODEL.partition("[nodes.left]")[2].partition("[inputs]")[0]
)
FIXES = ("--topic", "gnss=/gps/fix")
START_S = 8.0


@pytest.fixture(scope="module")
def robot(tmp_path_factory):
    """Return the drive, its messages, and the folder of its vehicle.toml."""
    folder = tmp_path_factory.mktemp("robot")
    driven = drive(folder)
    (folder / "vehicle.toml").write_text(VEHICLE, "utf-8")
    return driven, messages(driven), folder


@pytest.fixture(scope="module")
def logs(robot) -> dict[str, Path]:
    """Return the log of each writer; verbs run on the complete one, the others hold its first seconds."""
    start = [it for it in robot[1] if it.t < START_S]
    return {
        writer: write(robot[2] / writer, writer, robot[1] if writer == "rosbag2" else start)
        for writer in WRITERS
    }


@pytest.fixture(scope="module")
def bag(logs) -> Path:
    return logs["rosbag2"]


@pytest.mark.parametrize("writer", WRITERS)
def test_the_samples_are_the_same_for_every_writer(writer, robot, logs):
    driven = robot[0]
    form = InputFormat(
        topic_selection=TopicSelection(node_is_on_wheel={"left": True, "right": True}, wheel_radius=RADIUS)
    )
    read = read_log(logs[writer], input_format=form)
    assert read.t_zero_ns == T0
    end = np.inf if writer == "rosbag2" else START_S
    for node in ("left", "right"):
        table = driven.nodes[node]
        written = table.t < end
        assert np.array_equal(read.nodes[node].gyro, table.gyro[written])
        assert np.array_equal(read.nodes[node].accel, table.accel[written])
        np.testing.assert_allclose(read.nodes[node].t, table.t[written], rtol=0, atol=1e-9)
    speed, yaw_rate = (driven.reference[name][driven.reference.t < end] for name in ("speed", "yaw_rate"))
    assert np.array_equal(read.reference["speed"], speed)
    assert np.array_equal(read.reference["yaw_rate"], yaw_rate)
    np.testing.assert_allclose(read.wheels["left"], speed - 0.4 * yaw_rate, rtol=0, atol=1e-12)
    assert set(read.gnss["sigma"]) == {0.5}
    assert read.gnss["latitude_deg"] == pytest.approx(47.0, abs=0.01)
    assert [line for line in read.warnings if "not used: /camera/info" in line] == [read.warnings[-1]]


@pytest.mark.parametrize("writer", WRITERS)
def test_rates_are_those_of_the_stamps_and_not_of_the_bursts_of_the_recorder(writer, logs):
    done = hubodo("info", logs[writer], "--json")
    shown = json.loads(done.out)
    streams = {stream["topic"]: stream for stream in shown["streams"]}
    assert set(streams) == set(TOPICS)
    assert streams["/imu/left_wheel"]["rate"] == pytest.approx(RATE)
    assert shown["gaps"] == []
    assert shown["topics"]["gnss"] == "/gps/fix"


def test_fuse_and_gap_run_on_the_bag_of_a_robot_with_its_own_topics(robot, bag, tmp_path):
    folder = robot[2]
    topic_options = ["--topic", "left=/imu/left_wheel", "--topic", "right=/imu/right_wheel", *FIXES]
    for number, words in enumerate((topic_options, [])):
        done = hubodo("fuse", bag, "--vehicle", folder / "vehicle.toml", *words, "-o", tmp_path / str(number))
        assert done.code == 0, done.err
    one, other = (json.loads((tmp_path / k / "fuse.json").read_text()) for k in "01")
    assert one["distance"] == other["distance"] == pytest.approx(49.0, abs=0.2)
    assert one["wheel_nodes"] == ["left", "right"]
    assert "fixes" in one["methods"][1]
    assert any("node left is taken to be /imu/left_wheel" in line for line in other["warnings"])
    assert not any("taken to be" in line for line in one["warnings"])
    model = tmp_path / "model.toml"
    model.write_text(MODEL)
    done = hubodo("gap", model, bag, "-o", tmp_path / "gap")
    assert done.code == 0, done.err
    assert json.loads((tmp_path / "gap" / "gap.json").read_text())["verdict"] == "no_gap"


def test_allan_export_and_import_run_on_a_bag(robot, bag, tmp_path):
    words = ("--topic", "left=/imu/left_wheel")
    done = hubodo("allan", bag, *words, "--node", "left", "--end", 4, "--json")
    assert done.code == 0, done.err
    assert json.loads(done.out)["coefficients"]["N"]["value"] == pytest.approx(0.0004, rel=0.5)
    vehicle = ("--vehicle", robot[2] / "vehicle.toml")
    assert hubodo("export", bag, *vehicle, "-o", tmp_path / "csv").code == 0
    names = {path.name for path in (tmp_path / "csv").iterdir()}
    assert names == {"left.csv", "right.csv", "reference.csv", "gnss.csv", "wheels.csv"}
    done = hubodo("import", bag, *vehicle, "-o", tmp_path / "ours.mcap")
    assert done.code == 0, done.err
    assert read_log(tmp_path / "ours.mcap").metadata["topics"].startswith("left = /imu/left_wheel")


def test_topics_can_be_set_in_the_vehicle_file(bag, tmp_path):
    vehicle = tmp_path / "vehicle.toml"
    topics = 'l = "/imu/left_wheel"\nr = "/imu/right_wheel"\nwheels = "-"\ngnss = "/gone"\n'
    named = VEHICLE.replace("[nodes.left]", "[nodes.l]").replace("[nodes.right]", "[nodes.r]")
    vehicle.write_text(f"{named}[topics]\n{topics}")
    done = hubodo("fuse", bag, "--vehicle", vehicle, "--no-graph", "-o", tmp_path / "out", "--json")
    assert done.code == 0, done.err
    result = json.loads(done.out)
    assert result["wheel_nodes"] == ["l", "r"]
    assert "another odometer" not in result["methods"][0]
    assert any("[topics] gnss=/gone: no such topic" in line for line in result["warnings"])


@pytest.mark.parametrize(
    ("words", "error"),
    [
        (
            "left=/imu/left_weel",
            "of a known type, did you mean '/imu/left_wheel'?; of its type there are",
        ),
        ("left=/gps/fix", "is sensor_msgs/msg/NavSatFix; left needs sensor_msgs/msg/Imu"),
        ("wheels=/joint_states:a,b", "joints steering, wheel_left_joint, wheel_right_joint; name the left"),
        ("left", "write NAME=/TOPIC"),
    ],
)
def test_an_unsuitable_topic_is_refused_with_the_suitable_ones(words, error, robot, bag, tmp_path):
    vehicle = robot[2] / "vehicle.toml"
    done = hubodo("fuse", bag, "--vehicle", vehicle, "--topic", words, "-o", tmp_path / "out")
    assert done.code == 2
    assert error in done.err
    assert not (tmp_path / "out").exists()


def candidates_by_topic(**kinds: str) -> dict[str, TopicCandidate]:
    return {topic.replace("__", "/"): TopicCandidate(kind) for topic, kind in kinds.items()}


IMU, FIX, ODOMETRY, TWIST = ros2.IMU, ros2.NAV_SAT_FIX, ros2.ODOMETRY, ros2.TWIST_STAMPED
WHEELS = {"left": True, "right": True}


@pytest.mark.parametrize(
    ("candidates", "choice", "words"),
    [
        (
            candidates_by_topic(__a=FIX, __b=FIX),
            {},
            r"/a \(.*NavSatFix\), /b .* could each be gnss; add --topic gnss=/a",
        ),
        (
            candidates_by_topic(__odom=ODOMETRY, __speed=TWIST),
            {},
            r"could each be reference; add --topic reference=/odom",
        ),
        (
            candidates_by_topic(__x__imu=IMU, __y=IMU),
            {"node_is_on_wheel": WHEELS},
            r"each be node left; add --topic left=/x/imu",
        ),
        (
            candidates_by_topic(__front__left=IMU, __rear__left=IMU, __right=IMU),
            {"node_is_on_wheel": WHEELS},
            "/front/left, /rear/left .* could each be node left",
        ),
        ({"/j": TopicCandidate(ros2.JOINT_STATE, ("left_a", "left_b", "right"))}, {}, "/j:left_a,right, or"),
    ],
)
def test_two_candidates_for_a_role_are_refused_with_the_option_to_use(candidates, choice, words):
    with pytest.raises(InputError, match=words):
        assign_roles(candidates, TopicSelection(**choice), is_hubodo=False, log_name="bag")
    # A verb that does not need the role continues with a warning.
    notes = assign_roles(
        candidates, TopicSelection(**choice, required_roles=frozenset()), is_hubodo=False, log_name="bag"
    ).notes
    assert any("could each be" in note or "name the left" in note for note in notes)


@pytest.mark.parametrize(
    ("candidates", "choice", "nodes", "files"),
    [
        (candidates_by_topic(__a=FIX, __b=FIX), {"explicit": {"gnss": "/b"}}, {}, {"gnss": "/b"}),
        (candidates_by_topic(__a=FIX, __b=FIX), {"explicit": {"gnss": "-"}}, {}, {}),
        (candidates_by_topic(__cmd_vel=TWIST, __odom=ODOMETRY), {}, {}, {"reference": "/odom"}),
        (
            candidates_by_topic(__truth=ODOMETRY, __odom=ODOMETRY),
            {},
            {},
            {"reference": "/odom", "truth": "/truth"},
        ),
        (candidates_by_topic(__imu__data=IMU), {"node_is_on_wheel": {"hub": True}}, {"hub": "/imu/data"}, {}),
        (candidates_by_topic(__imu__data=IMU), {}, {"imu_data": "/imu/data"}, {}),
        (
            candidates_by_topic(__leftWheel=IMU, __imu=IMU),
            {"node_is_on_wheel": WHEELS},
            {"left": "/leftWheel", "imu": "/imu"},
            {},
        ),
        (candidates_by_topic(__left__imu=IMU), {"node_is_on_wheel": WHEELS}, {"left": "/left/imu"}, {}),
    ],
)
def test_roles_with_a_single_candidate_are_found_by_type_and_name(candidates, choice, nodes, files):
    roles = assign_roles(candidates, TopicSelection(**choice), is_hubodo=False, log_name="bag")
    assert (dict(roles.nodes), dict(roles.files)) == (nodes, files)


@pytest.mark.parametrize(
    ("topic", "name"),
    [("left/imu", "left"), ("/left/imu", "left"), ("/imu/data", "imu_data"), ("/imu", "imu")],
)
def test_a_node_is_named_like_its_topic(topic, name):
    assert node_name_of_topic(topic) == name


def test_bags_of_a_killed_recorder_and_in_several_files_are_read(robot, bag, tmp_path):
    whole = read_log(bag, input_format=InputFormat(topic_selection=TopicSelection(wheel_radius=RADIUS)))
    killed = shutil.copytree(bag, tmp_path / "killed")
    (killed / "metadata.yaml").unlink()
    for path in (killed, next(killed.glob("*.db3"))):
        assert np.array_equal(read_log(path).reference["speed"], whole.reference["speed"])
    half = len(robot[1]) // 2
    parts = tmp_path / "parts"
    parts.mkdir()
    for number, topic_options in enumerate((robot[1][:half], robot[1][half:])):
        write(parts / f"parts_{number}", "foxglove-sdk", topic_options)
    read = read_log(parts)
    assert np.array_equal(read.reference["speed"], whole.reference["speed"])
    assert read.t_zero_ns == T0


def test_the_intact_part_of_a_damaged_bag_is_read_and_the_loss_reported(bag, tmp_path):
    broken = shutil.copytree(bag, tmp_path / "bag")
    file = next(broken.glob("*.db3"))
    data = bytearray(file.read_bytes())
    data[len(data) // 2 : len(data) // 2 + 8192] = bytes(8192)
    file.write_bytes(data)
    read = read_log(broken)
    assert 100 < len(read.nodes["imu_left_wheel"]) < RATE * 43
    assert any("messages are kept, the others cannot be read" in line for line in read.warnings)
    file.write_bytes(data[:4000])
    done = hubodo("info", broken)
    assert (done.code, done.err.count("\n")) == (2, 1)
    assert "cannot be read as a rosbag" in done.err
    with sqlite3.connect(tmp_path / "other.db3") as other:
        other.execute("CREATE TABLE cities (name TEXT)")
    assert hubodo("info", tmp_path / "other.db3").code == 2
