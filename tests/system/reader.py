"""A reader of everything that the vehicle publishes: `python reader.py ROUTER VEHICLE LEASE_MS CALLBACK_S`.

It has nothing but Zenoh, and no shared memory, like a laptop: the pictures come through its connection. A LEASE_MS of 0
keeps Zenoh's default; CALLBACK_S is the time that it spends on each message. It prints a line when it reads pictures.
"""

import json
import sys
import time

import zenoh


def main(router: str, vehicle: str, lease_ms: str, callback_s: str) -> None:
    config = zenoh.Config()
    config.insert_json5("mode", '"client"')
    config.insert_json5("connect/endpoints", json.dumps([router]))
    config.insert_json5("scouting/multicast/enabled", "false")
    config.insert_json5("transport/shared_memory/enabled", "false")
    if lease_ms != "0":
        config.insert_json5("transport/link/tx/lease", lease_ms)

    def on_sample(sample: zenoh.Sample) -> None:
        if str(sample.key_expr).endswith("sensor/camera"):
            print("reads", flush=True)
        time.sleep(float(callback_s))

    with zenoh.open(config) as session:
        everything = f"jezero/{vehicle}/**"
        subscriber = session.declare_subscriber(everything, on_sample)
        tokens = session.liveliness().declare_subscriber(f"jezero/{vehicle}/@alive/**", lambda _: None)
        sys.stdin.read()  # until the test ends
        del subscriber, tokens


if __name__ == "__main__":
    main(*sys.argv[1:])
