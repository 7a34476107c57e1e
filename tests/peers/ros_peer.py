#!/usr/bin/env python3
"""Programs of ROS 2 that are none of ours, by zenoh-ros2-sdk: robots, and a console that sees their teams.

    ros_peer.py robots PORT NAME:X:Y[:ODOM] ...   robots that publish odometry ten times a second
    ros_peer.py console PORT NAME ...             prints what it receives of the teams of these robots
    ros_peer.py echo PORT NAME                    prints when it receives odometry of a robot
    ros_peer.py graph PORT                        prints the nodes and topics that are there, once

A robot stands at X, Y of the frame map, and its odometry counts from the place where it was started: the frame odom lies
at 100, 50 of map, turned by a quarter. ODOM is one of
    tf        transforms of map to odom on /NAME/tf, with frames without prefix (the default)
    static    the same once, on /NAME/tf_static, kept by the publisher for those that come late; and its superior, the second of its
              pair, in the same way on /NAME/superior
    none      no transforms
    humble    as tf, with keys of Humble, which knows no hashes of types
    bare      as tf, without the attachment
    other     as tf, with a hash of another definition
    dds       as tf, put as zenoh-bridge-ros2dds puts it: under the name of the topic, without attachment
With --shared all robots publish transforms on /tf, with the name of the robot before each frame. The texts of messages are
those of rosbags. It runs until it is killed.
"""

import argparse
import json
import math
import sys
import time

import numpy as np
import zenoh
import zenoh.ext
from rosbags.typesys import Stores, get_typestore
from zenoh_ros2_sdk import ROS2Publisher, ROS2Subscriber, ZenohSession, get_topic_info, get_topic_names_and_types

STORE = get_typestore(Stores.ROS2_JAZZY)
SOURCE = (100.0, 50.0, math.pi / 2)


def text_of(name):
    return STORE.generate_msgdef(name, ros_version=2)[0]


def publisher(topic, name, port, mode="tf", **more):
    hashes = {"humble": "TypeHashNotSupported", "other": "RIHS01_" + "ab" * 32}
    return ROS2Publisher(
        topic, name, msg_definition=text_of(name), type_hash=hashes.get(mode, STORE.hash_rihs01(name)),
        router_port=port, **more,
    )  # fmt: skip


def subscriber(topic, name, port, callback):
    return ROS2Subscriber(
        topic, name, callback, msg_definition=text_of(name), type_hash=STORE.hash_rihs01(name), router_port=port
    )


def quaternion(session, angle):
    return session.store.types["geometry_msgs/msg/Quaternion"](x=0.0, y=0.0, z=math.sin(angle / 2), w=math.cos(angle / 2))


def header(session, frame):
    types = session.store.types
    now = time.time_ns()
    stamp = types["builtin_interfaces/msg/Time"](sec=now // 10**9, nanosec=now % 10**9)
    return types["std_msgs/msg/Header"](stamp=stamp, frame_id=frame)


def transform(session, parent, child):
    types = session.store.types
    x, y, angle = SOURCE
    return types["geometry_msgs/msg/TransformStamped"](
        header=header(session, parent),
        child_frame_id=child,
        transform=types["geometry_msgs/msg/Transform"](
            translation=types["geometry_msgs/msg/Vector3"](x=x, y=y, z=0.0), rotation=quaternion(session, angle)
        ),
    )


class Robot:
    def __init__(self, text, port, shared):
        name, x, y, *mode = text.split(":")
        self.name, self.mode, self.shared = name, (mode or ["tf"])[0], shared
        # Where it is, in its own odometry: map turned back, and counted from where odom lies.
        dx, dy = float(x) - SOURCE[0], float(y) - SOURCE[1]
        self.at = (dy, -dx)
        self.odom = publisher(f"/{name}/odom", "nav_msgs/msg/Odometry", port, self.mode, node_name=f"driver_{name}")
        self.prefix = f"{name}/" if shared else ""
        self.kept = self.tf = None
        self.session = self.odom.session_mgr
        topic = "/tf" if shared else f"/{name}/tf"
        if self.mode == "static":
            self.keep(port)
        elif self.mode != "none":
            mode = "tf" if self.mode == "other" else self.mode
            self.tf = publisher(topic, "tf2_msgs/msg/TFMessage", port, mode, node_name=f"localisation_{name}")

    def keep(self, port):
        tf_static = "/tf_static" if self.shared else f"/{self.name}/tf_static"
        self.kept = [
            self.keep_one(port, tf_static, "tf2_msgs/msg/TFMessage", self.tf_message),
            self.keep_one(port, f"/{self.name}/superior", "std_msgs/msg/String", self.superior),
        ]

    def keep_one(self, port, topic, name, make):
        """One message, kept by an advanced publisher as rmw_zenoh has it for transient-local."""
        plain = publisher(topic, name, port, node_name=f"static_{self.name}")
        cache = zenoh.ext.CacheConfig(max_samples=1)
        kept = zenoh.ext.declare_advanced_publisher(
            self.session.session, plain.keyexpr, cache=cache, publisher_detection=True
        )
        kept.put(make(), attachment=plain._create_attachment(1, time.time_ns()))
        return plain, kept

    def superior(self):
        message = self.session.store.types["std_msgs/msg/String"](data=f"{self.name[0]}2")
        return bytes(self.session.store.serialize_cdr(message, "std_msgs/msg/String"))

    def tf_message(self):
        types = self.session.store.types
        one = transform(self.session, "map", f"{self.prefix}odom")
        message = types["tf2_msgs/msg/TFMessage"](transforms=[one])
        return bytes(self.session.store.serialize_cdr(message, "tf2_msgs/msg/TFMessage"))

    def put(self):
        types = self.session.store.types
        point = types["geometry_msgs/msg/Point"](x=self.at[0], y=self.at[1], z=0.0)
        pose = types["geometry_msgs/msg/Pose"](position=point, orientation=quaternion(self.session, 0.0))
        zero = types["geometry_msgs/msg/Vector3"](x=0.0, y=0.0, z=0.0)
        fields = dict(
            header=header(self.session, f"{self.prefix}odom"),
            child_frame_id=f"{self.prefix}base_link",
            pose=types["geometry_msgs/msg/PoseWithCovariance"](pose=pose, covariance=np.zeros(36)),
            twist=types["geometry_msgs/msg/TwistWithCovariance"](
                twist=types["geometry_msgs/msg/Twist"](linear=zero, angular=zero), covariance=np.zeros(36)
            ),
        )
        if self.mode in ("bare", "dds"):
            self.put_plain(fields)
            return
        self.odom.publish(**fields)
        if self.tf:
            self.tf.publish(transforms=[transform(self.session, "map", f"{self.prefix}odom")])

    def put_plain(self, fields):
        """Without an attachment; as zenoh-bridge-ros2dds under the name of the topic alone."""
        types, store = self.session.store.types, self.session.store
        message = types["nav_msgs/msg/Odometry"](**fields)
        odom = bytes(store.serialize_cdr(message, "nav_msgs/msg/Odometry"))
        put = self.session.session.put
        if self.mode == "bare":
            put(self.odom.keyexpr, odom)
            self.tf.publish(transforms=[transform(self.session, "map", f"{self.prefix}odom")])
        else:
            put(f"{self.name}/odom", odom)
            put("tf" if self.shared else f"{self.name}/tf", self.tf_message())


def robots(arguments):
    fleet = [Robot(text, arguments.port, arguments.shared) for text in arguments.rest]
    print(f"{len(fleet)} robots publish", flush=True)
    while True:
        for robot in fleet:
            robot.put()
        time.sleep(0.1)


def console(arguments):
    def say(what, **more):
        print(json.dumps({"what": what, **more}), flush=True)

    def diagnostics(message):
        statuses = {status.name: [int(status.level), status.message] for status in message.status}
        say("diagnostics", statuses=statuses)

    def markers(message):
        # Spheres of a team, as [x, y] in the order of the message.
        spheres = [marker for marker in message.markers if marker.type == 7]
        points = [[[point.x, point.y] for point in marker.points] for marker in spheres]
        say("markers", frame=message.markers[-1].header.frame_id, points=points)

    port = arguments.port
    keep = [
        subscriber("/muster/teams", "std_msgs/msg/String", port, lambda m: say("teams", text=m.data)),
        subscriber("/diagnostics", "diagnostic_msgs/msg/DiagnosticArray", port, diagnostics),
        subscriber("/muster/markers", "visualization_msgs/msg/MarkerArray", port, markers),
    ]
    for name in arguments.rest:
        def team(message, name=name):
            say("team", robot=name, text=message.data)

        keep.append(subscriber(f"/{name}/team", "std_msgs/msg/String", port, team))
    print("the console listens", flush=True)
    while keep:
        time.sleep(1)


def echo(arguments):
    name = arguments.rest[0]
    keep = subscriber(
        f"/{name}/odom", "nav_msgs/msg/Odometry", arguments.port, lambda message: print("received", flush=True)
    )
    print("the echo listens", flush=True)
    while keep:
        time.sleep(1)


def graph(arguments):
    port = arguments.port
    session = ZenohSession.get_instance(router_port=port)
    tokens = [str(reply.ok.key_expr) for reply in session.liveliness.get("@ros2_lv/0/**", timeout=2.0) if reply.ok]
    nodes = sorted(token.split("/")[8] for token in tokens if token.split("/")[5] == "NN")
    topics = dict(get_topic_names_and_types(router_port=port, timeout=2.0))
    publishers, subscriptions = {}, {}
    for topic in topics:
        info = get_topic_info(topic, router_port=port, timeout=0.5, verbose=True)
        publishers[topic] = [[one.node_name, one.topic_type, one.type_hash, one.qos] for one in info.publishers]
        subscriptions[topic] = [one.node_name for one in info.subscribers]
    found = {"nodes": nodes, "topics": topics, "publishers": publishers, "subscriptions": subscriptions}
    print(json.dumps(found), flush=True)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=["robots", "console", "echo", "graph"])
    parser.add_argument("port", type=int)
    parser.add_argument("rest", nargs="*")
    parser.add_argument("--shared", action="store_true")
    arguments = parser.parse_args()
    {"robots": robots, "console": console, "echo": echo, "graph": graph}[arguments.what](arguments)


if __name__ == "__main__":
    sys.exit(main())
