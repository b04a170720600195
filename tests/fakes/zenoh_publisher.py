"""A Zenoh router that publishes an Imu topic in the form of rmw_zenoh, in its own process.

    python tests/fakes/zenoh_publisher.py PORT PAYLOADS.json

The file holds CDR messages as hexadecimal text. They are sent on domain 7, /left_wheel/imu, after a line on
the standard input; after a second line the publisher withdraws.
"""

import json
import struct
import sys
import time
from pathlib import Path

import zenoh
from zenoh_subscriber import router_config

# As `ros2 topic info -v` prints it in ROS 2 Jazzy.
IMU = "sensor_msgs::msg::dds_::Imu_/RIHS01_7d9a00ff131080897a5ec7e26e315954b8eae3353c3f995c55faf71574000b5b"
TOPIC = "left_wheel/imu"


def main():
    payloads = [bytes.fromhex(text) for text in json.loads(Path(sys.argv[2]).read_text())]
    with zenoh.open(router_config(sys.argv[1])) as session:
        name = TOPIC.replace("/", "%")
        token = f"@ros2_lv/7/{session.info.zid()}/0/1/MP/%/%/driver/%{name}/{IMU}/2::,5:,:,:,,"
        declared = session.liveliness().declare_token(token)
        publisher = session.declare_publisher(f"7/{TOPIC}/{IMU}")
        print("ready", flush=True)
        sys.stdin.readline()
        end = time.monotonic() + 300.0
        while not publisher.matching_status.matching and time.monotonic() < end:
            time.sleep(0.01)
        for number, payload in enumerate(payloads, 1):
            attachment = struct.pack("<qqB16s", number, time.time_ns(), 16, bytes(16))
            publisher.put(payload, attachment=attachment)
        sys.stdin.readline()
        publisher.undeclare()
        declared.undeclare()
        time.sleep(0.3)  # for the token on its way


if __name__ == "__main__":
    main()
