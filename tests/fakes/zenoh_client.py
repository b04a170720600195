"""A Zenoh router that calls the services of a ROS 2 node in the form of rmw_zenoh, in its own process.

    python tests/fakes/zenoh_client.py PORT

After a line on the standard input it calls /hubodo/find_bias and prints keys, payloads and attachments of the
replies, as hexadecimal text, with the tokens of services, as one JSON object.
"""

import json
import struct
import sys
import time

import zenoh
from zenoh_subscriber import router_config

# As in a public client of a ROS 2 node over Zenoh.
TRIGGER_HASH = "RIHS01_eeff2cd6fa5ad9d27cdf4dec64818317839b62f212a91e6b5304b634b2062c5f"
KEY = f"7/hubodo/find_bias/std_srvs::srv::dds_::Trigger_/{TRIGGER_HASH}"
ATTACHMENT = struct.pack("<qqB16s", 42, 1_700_000_000_000_000_000, 16, bytes(range(16)))
SERVICES = 3


def main():
    with zenoh.open(router_config(sys.argv[1])) as session:
        print("ready", flush=True)
        sys.stdin.readline()
        tokens = []
        end = time.monotonic() + 300.0
        while (
            len(tokens) < SERVICES and time.monotonic() < end
        ):  # until the session of the node has connected
            tokens = [str(reply.ok.key_expr) for reply in session.liveliness().get("@ros2_lv/7/*/*/*/SS/**")]
        request = b"\x00\x01\x00\x00\x00"
        replies = [
            [str(reply.ok.key_expr), reply.ok.payload.to_bytes().hex(), reply.ok.attachment.to_bytes().hex()]
            for reply in session.get(KEY, payload=request, attachment=ATTACHMENT, timeout=300.0)
        ]
    print(json.dumps({"replies": replies, "tokens": tokens}))


if __name__ == "__main__":
    main()
