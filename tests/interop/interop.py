"""hubodo as a ROS 2 node, received by Fast DDS, the default middleware of ROS 2, in a program in C++.

    python tests/interop/interop.py [--seconds 6] [--domain 77]

Two emulated nodes drive at 208 Hz. The subscriber has the settings of a ROS 2 node with default
environment. The table compares what it received with the log; the exit code is 1 if a topic
differs. `make interop` installs compiler and library if it can and builds the subscriber.
"""

import json
import math
import os
import subprocess
import sys
import tempfile
from contextlib import ExitStack
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from mcap_ros2.decoder import DecoderFactory

from fakes.fake_node import FakeNode
from generators.fake_drive import VEHICLE_TOML, raw_rows, short_drive
from hubodo.log.recording_reader import open_log
from in_process import hubodo
from script_arguments import script_parser

ROOT = Path(__file__).resolve().parents[2]
ODOMETRY, IMU, TF = (
    "nav_msgs::msg::dds_::Odometry_",
    "sensor_msgs::msg::dds_::Imu_",
    "tf2_msgs::msg::dds_::TFMessage_",
)
DIAGNOSTICS = "diagnostic_msgs::msg::dds_::DiagnosticArray_"
# Name, type, reliable, transient local: as requested by robot_localization, tf2 and rqt_robot_monitor.
TOPICS = (
    ("/odom", ODOMETRY, 1, 0),
    ("/tf", TF, 1, 0),
    ("/tf_static", TF, 1, 1),
    ("/left/imu", IMU, 0, 0),
    ("/right/imu", IMU, 0, 0),
    ("/left/temperature", "sensor_msgs::msg::dds_::Temperature_", 0, 0),
    ("/left/battery", "sensor_msgs::msg::dds_::BatteryState_", 0, 0),
    ("/diagnostics", DIAGNOSTICS, 1, 0),
)
SUBSCRIBER = ROOT / "out/interop/subscriber"


def record(folder, seconds):
    """Record two emulated nodes while the subscriber runs; return its lines by topic."""
    drive = short_drive(5)
    (folder / "vehicle.toml").write_text(VEHICLE_TOML)
    wanted = [str(word) for name, *kind in TOPICS for word in (f"rt{name}", *kind)]
    command = [str(SUBSCRIBER), os.environ["ROS_DOMAIN_ID"], str(seconds + 1.5), *wanted]
    subscriber = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    assert subscriber.stdout.readline() == "ready\n"
    with ExitStack() as stack:
        nodes = {
            name: stack.enter_context(FakeNode(node_id=number, rows=raw_rows(drive, name)))
            for number, name in ((1, "left"), (2, "right"))
        }
        ports = [f"{name}={node.path}" for name, node in nodes.items()]
        options = ("--vehicle", folder / "vehicle.toml", "--duration", seconds, "--ros2", "--quiet", "--json")
        done = hubodo("record", *ports, "-o", folder / "ride.mcap", *options)
    assert done.code == 0, done.err
    return {
        row["topic"].removeprefix("rt"): row
        for row in map(json.loads, subscriber.communicate()[0].splitlines())
    }


def logged(path):
    """Return the messages of each topic of the log, decoded by another package."""
    log, decoders, messages = open_log(path), {}, {}
    for message in log.messages():
        channel = log.scan.channels[message.channel]
        if message.topic not in {name for name, *_ in TOPICS}:
            continue
        if message.topic not in decoders:
            schema = log.scan.schemas[channel.schema_id]
            decoders[message.topic] = DecoderFactory().decoder_for("cdr", schema)
        messages.setdefault(message.topic, []).append(decoders[message.topic](message.data))
    return messages


def vector(value, names):
    return [getattr(value, name) for name in names]


def odometry_values(message):
    pose, twist = message.pose, message.twist
    values = vector(pose.pose.position, "xyz") + vector(pose.pose.orientation, "xyzw") + list(pose.covariance)
    return (
        values
        + vector(twist.twist.linear, "xyz")
        + vector(twist.twist.angular, "xyz")
        + list(twist.covariance)
    )


def imu_values(message):
    values = vector(message.orientation, "xyzw") + list(message.orientation_covariance)
    values += vector(message.angular_velocity, "xyz") + list(message.angular_velocity_covariance)
    return values + vector(message.linear_acceleration, "xyz") + list(message.linear_acceleration_covariance)


def content_differs(topic, kind, row, messages):
    """Return how the newest message received differs from the message of the log with its stamp."""
    if kind == TF:
        frames = {(item["frame"], item["child"]) for item in row["transforms"]}
        expected = {(t.header.frame_id, t.child_frame_id) for t in messages[-1].transforms}
        return "" if frames == expected else f"frames {frames}, not {expected}"
    if kind == DIAGNOSTICS:
        return "" if len(row["status"]) >= 5 else f"{len(row['status'])} entries"
    stamps = [m.header.stamp.sec + 1e-9 * m.header.stamp.nanosec for m in messages]
    nearest = min(range(len(stamps)), key=lambda n: abs(stamps[n] - row["stamp"]))
    message = messages[nearest]
    if abs(stamps[nearest] - row["stamp"]) > 1e-6 or row["frame"] != message.header.frame_id:
        return "stamp or frame"
    if kind == ODOMETRY:
        expected = odometry_values(message)
    elif kind == IMU:
        expected = imu_values(message)
    else:
        return ""
    near = all(
        math.isclose(a, b, rel_tol=1e-12, abs_tol=1e-15) for a, b in zip(row["values"], expected, strict=True)
    )
    return "" if near else "values"


def main():
    parser = script_parser(__doc__)
    parser.add_argument("--seconds", type=float, default=6.0)
    parser.add_argument("--domain", type=int, default=77)
    args = parser.parse_args()
    os.environ["ROS_DOMAIN_ID"] = str(args.domain)
    folder = Path(tempfile.mkdtemp())
    rows = record(folder, args.seconds)
    messages, failed = logged(folder / "ride.mcap"), False
    print(f"  {'topic':<18} {'in the log':>10} {'received':>9} {'rate Hz':>8} {'matched':>8} {'QoS':>13}")
    for topic, kind, reliable, _ in TOPICS:
        row, sent = rows[topic], len(messages.get(topic, ()))
        problem = "nothing received" if not row["count"] else ""
        problem = problem or content_differs(topic, kind, row, messages.get(topic, ()))
        problem = problem or ("not decoded" if row["errors"] else "")
        failed |= bool(problem) or not row["matched"] or bool(row["incompatible"])
        quality = "incompatible" if row["incompatible"] else "reliable" if reliable else "best effort"
        cells = f"{sent:>10} {row['count']:>9} {row['rate']:>8.1f} {row['matched']:>8} {quality:>13}"
        print(f"  {topic:<18} {cells}  {problem or 'equal'}")
    return int(failed)


if __name__ == "__main__":
    sys.exit(main())
