"""A router of another version of Zenoh: that of eclipse-zenoh as this Python finds it.

Arguments: the configuration of a router (deploy/router/plain.json5) and an endpoint to listen at. It tells what it is, as
zenohd and the router of ROS do. Prints the version and the endpoint once it listens, and runs until it is killed.
"""

import sys
import time
from importlib.metadata import version

import zenoh

config = zenoh.Config.from_file(sys.argv[1])
config.insert_json5("listen/endpoints", f'["{sys.argv[2]}"]')
config.insert_json5("adminspace", '{"enabled": true, "permissions": {"read": true, "write": false}}')
with zenoh.open(config):
    print("a router of Zenoh", version("eclipse-zenoh"), "listens at", sys.argv[2], flush=True)
    while True:
        time.sleep(60)
