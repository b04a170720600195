"""A Zenoh router with a subscriber of /odom and the tokens of a graph, in its own process.

    python tests/fakes/zenoh_subscriber.py PORT

It prints `received` once it has received `EXPECTED` messages. After a line on the standard input it prints
what it received as one JSON object: keys, payloads as hexadecimal text, attachments and tokens. The router
takes the place of rmw_zenohd.
"""

import json
import sys
import time

import zenoh

EXPECTED = 201


def router_config(port):
    """Return the settings of a router on a port of this computer, without other routers."""
    config = zenoh.Config()
    for key, value in {
        "mode": '"router"',
        "listen/endpoints": f'["tcp/127.0.0.1:{port}"]',
        "scouting/multicast/enabled": "false",
    }.items():
        config.insert_json5(key, value)
    return config


def main():
    messages, tokens = [], []
    with zenoh.open(router_config(sys.argv[1])) as session:

        def note_message(sample):
            attachment = sample.attachment.to_bytes().hex() if sample.attachment else ""
            messages.append([str(sample.key_expr), sample.payload.to_bytes().hex(), attachment])
            if len(messages) == EXPECTED:
                print("received", flush=True)

        session.declare_subscriber("*/odom/**", note_message)
        session.liveliness().declare_subscriber(
            "@ros2_lv/**",
            lambda sample: tokens.append([str(sample.kind), str(sample.key_expr)]),
            history=True,
        )
        print("ready", flush=True)
        sys.stdin.readline()
        time.sleep(0.5)  # for the last tokens
    print(json.dumps({"messages": messages, "tokens": tokens}))


if __name__ == "__main__":
    main()
