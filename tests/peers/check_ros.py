#!/usr/bin/env python3
"""Compares the messages of shared/ros with those of rosbags: bytes in both byte orders, values, and hashes of types.

    python3 -m venv venv && venv/bin/pip install -r tests/peers/requirements.txt
    cargo build --package muster-ros --example messages
    venv/bin/python tests/peers/check_ros.py target/debug/examples/messages [--seed S] [--messages N]

Each message that one side makes up is read and written by the other. Every type of each version of ROS from Humble to
the newest that rosbags knows is defined by its text, and its hash compared. Ends with 'N passed, N failed', and code 1
if anything failed.
"""

import argparse
import json
import math
import random
import struct
import subprocess
import sys
import warnings

import numpy as np
from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

VERSIONS = ["ROS2_HUMBLE", "ROS2_JAZZY", "ROS2_KILTED", "ROS2_LYRICAL"]

# What fleets send, and what is hard to align.
TYPES = [
    "nav_msgs/msg/Odometry",
    "geometry_msgs/msg/PoseStamped",
    "geometry_msgs/msg/PoseWithCovarianceStamped",
    "sensor_msgs/msg/NavSatFix",
    "tf2_msgs/msg/TFMessage",
    "diagnostic_msgs/msg/DiagnosticArray",
    "visualization_msgs/msg/MarkerArray",
    "std_msgs/msg/String",
    "sensor_msgs/msg/LaserScan",
    "sensor_msgs/msg/PointCloud2",
    "rcl_interfaces/msg/ParameterEvent",
    "own_msgs/msg/Links",
]

OWN = {
    "own_msgs/msg/Link": "string peer\nfloat32 rssi -90.0\nuint8[3] kind\nbool up true",
    "own_msgs/msg/Links": (
        "std_msgs/Header header\nbyte LAST=7\nLink[] links\nLink[2] ends\nstring<=5 mode\nuint16[<=4] channels\n"
        "int64 a\nchar b\nfloat64[] c\nbyte[] d\nbool[3] e\nint8 f\nstring[] g\nuint64 h"
    ),
}


class Ours:
    """The example program, asked line by line."""

    def __init__(self, program):
        self.process = subprocess.Popen([program], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)

    def ask(self, **request):
        self.process.stdin.write(json.dumps(request) + "\n")
        self.process.stdin.flush()
        answer = json.loads(self.process.stdout.readline())
        if "error" in answer:
            raise ValueError(f"{request}: {answer['error']}")
        return answer


def make_base(rng, name, bound):
    if name == "string":
        text = "".join(rng.choice("aZ/_é€") for _ in range(rng.randint(0, 4)))
        while bound and len(text.encode()) > bound:
            text = text[:-1]
        return text
    if name == "bool":
        return rng.random() < 0.5
    if name == "char":
        return rng.randrange(256)
    if name == "byte":
        # rosbags takes it for a number with a sign.
        return rng.randrange(128)
    if name == "float32":
        return struct.unpack("<f", struct.pack("<f", rng.uniform(-1e6, 1e6)))[0]
    if name == "float64":
        return rng.uniform(-1, 1) * 10.0 ** rng.randint(-30, 30)
    signed, bits = name.startswith("int"), int(name.removeprefix("u").removeprefix("int"))
    low = -(2 ** (bits - 1)) if signed else 0
    return rng.randrange(low, low + 2**bits)


def make(rng, store, name):
    """A random message of rosbags."""
    values = {}
    for field, description in store.fielddefs[name][1]:
        values[field] = make_field(rng, store, description)
    return store.types[name](**values)


def make_field(rng, store, description):
    kind, what = int(description[0]), description[1]
    if kind == 1:
        return make_base(rng, *what)
    if kind == 2:
        return make(rng, store, what)
    inner, length = what
    count = length if kind == 3 else rng.randint(0, min(length or 4, 4))
    values = [make_field(rng, store, inner) for _ in range(count)]
    if int(inner[0]) == 1 and inner[1][0] != "string":
        base = inner[1][0]
        return np.array(values, dtype={"byte": "uint8", "char": "uint8"}.get(base, base))
    return values


def same(ours, theirs):
    """Whether a value of ours is one of rosbags."""
    if hasattr(theirs, "__msgtype__"):
        # rosbags appends _ to names that Python has; bytes are compared as well, so that no field can be missing.
        return all(same(value, getattr(theirs, name, None) if hasattr(theirs, name) else getattr(theirs, name + "_"))
                   for name, value in ours.items())
    if isinstance(theirs, (list, np.ndarray)):
        return len(ours) == len(theirs) and all(map(same, ours, theirs))
    if isinstance(theirs, (float, np.floating)):
        # No number is equal to what is none; both must be none.
        return float(ours) == float(theirs) or (math.isnan(float(ours)) and math.isnan(float(theirs)))
    if isinstance(theirs, (int, np.integer)) and not isinstance(theirs, bool) and theirs < 0 <= ours:
        return ours == int(theirs) + 256
    return ours == theirs


def as_ros(store):
    """The same types with uint8 for char, as rosidl_adapter has it: rosbags hashes char as a type of its own."""
    for name, (_, fields) in store.fielddefs.items():
        for at, (field, (kind, what)) in enumerate(fields):
            if kind == Nodetype.BASE and what[0] == "char":
                fields[at] = (field, (kind, ("uint8", 0)))
            elif kind in (Nodetype.ARRAY, Nodetype.SEQUENCE) and what[0] == (Nodetype.BASE, ("char", 0)):
                fields[at] = (field, (kind, ((Nodetype.BASE, ("uint8", 0)), what[1])))
    return store


def messages(ours, store, name, seed, count):
    """What differs between both sides of so many messages."""
    wrong = []
    rng = random.Random(f"{seed}/{name}")
    for number in range(count):
        if number % 2:
            message = make(rng, store, name)
            little, big = (bytes(store.serialize_cdr(message, name, little_endian=order)) for order in (True, False))
            answers = [ours.ask(read=name, bytes=bytes(raw).hex()) for raw in (little, big)]
        else:
            answers = [ours.ask(random=name, seed=rng.randrange(2**63))]
            message = store.deserialize_cdr(bytes.fromhex(answers[0]["little"]), name)
            little, big = (bytes(store.serialize_cdr(message, name, little_endian=order)) for order in (True, False))
            other = store.deserialize_cdr(bytes.fromhex(answers[0]["big"]), name)
            if not same(answers[0]["value"], other):
                wrong.append(f"{name} {number}: big-endian bytes mean something else")
        for answer in answers:
            if not same(answer["value"], message):
                wrong.append(f"{name} {number}: {answer['value']} is not {message}")
            for order, raw in (("little", little), ("big", big)):
                if answer[order] != raw.hex():
                    wrong.append(f"{name} {number}: {order} {answer[order]} is not {raw.hex()}")
    return wrong


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("program")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--messages", type=int, default=200, help="of each type")
    arguments = parser.parse_args()
    # Fields of numpy's bool and of floats that are no numbers are of no interest here.
    warnings.simplefilter("ignore")
    passed, failed = 0, []

    for version in VERSIONS:
        store = as_ros(get_typestore(Stores[version]))
        ours = Ours(arguments.program)
        known = set(ours.ask(types=True)["types"])
        for name in sorted(store.fielddefs):
            if "/msg/" not in name:
                continue
            theirs = store.hash_rihs01(name)
            try:
                if name not in known:
                    ours.ask(define=name, text=store.generate_msgdef(name, ros_version=2)[0])
                own = ours.ask(hash=name)["hash"]
            except ValueError as error:
                own = str(error)
            if own == theirs:
                passed += 1
            else:
                failed.append(f"{version}: {name} has the hash {theirs}, not {own}")

    store = get_typestore(Stores.ROS2_JAZZY)
    ours = Ours(arguments.program)
    for name, text in OWN.items():
        store.register(get_types_from_msg(text, name))
        ours.ask(define=name, text=text)
    known = set(ours.ask(types=True)["types"])
    for name in TYPES:
        if name not in known and name not in OWN:
            ours.ask(define=name, text=store.generate_msgdef(name, ros_version=2)[0])
        wrong = messages(ours, store, name, arguments.seed, arguments.messages)
        passed += arguments.messages - len(wrong)
        failed += wrong
        if name not in OWN and ours.ask(hash=name)["hash"] != store.hash_rihs01(name):
            failed.append(f"{name} has another hash")

    for problem in failed[:20]:
        print(problem)
    print(f"{passed} passed, {len(failed)} failed")
    sys.exit(1 if failed else 0)


if __name__ == "__main__":
    main()
