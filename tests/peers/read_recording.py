"""Reads a recording of a fleet with the reader of others, and prints what it has as JSON.

    read_recording.py FILE [--cut]

With --cut the file may end anywhere, as the recorder was killed; without it, it must have its index.
"""

import json
import sys

import jsonschema
from mcap.exceptions import EndOfFile
from mcap.reader import make_reader
from mcap.records import Attachment, Channel, Message, Metadata, Schema
from mcap.stream_reader import StreamReader

# Messages of each topic that are validated: it takes a millisecond each.
VALIDATED = 20


def main(path, is_cut):
    schemas, channels, counts, newest, poses = {}, {}, {}, {}, {}
    links, ranks = {}, {}
    found = {"metadata": {}, "attachments": [], "first": None, "last": None, "cut": False}
    validators = {}
    with open(path, "rb") as file:
        records = StreamReader(file, validate_crcs=True).records
        while True:
            try:
                record = next(records, None)
            except EndOfFile:
                assert is_cut, "the file ends too early"
                found["cut"] = True
                break
            if record is None:
                break
            if isinstance(record, Schema):
                schemas[record.id] = record
            elif isinstance(record, Channel):
                channels[record.id] = record
            elif isinstance(record, Metadata):
                found["metadata"][record.name] = record.metadata
            elif isinstance(record, Attachment):
                found["attachments"].append(record.name)
                json.loads(record.data)
            elif isinstance(record, Message):
                channel = channels[record.channel_id]
                topic = channel.topic
                counts[topic] = counts.get(topic, 0) + 1
                at = record.log_time / 1e9
                found["first"] = min(at, found["first"] or at)
                found["last"] = max(at, found["last"] or at)
                if channel.message_encoding != "json":
                    continue
                content = json.loads(record.data)
                newest[topic] = content
                if counts[topic] <= VALIDATED:
                    schema = schemas[channel.schema_id]
                    if schema.id not in validators:
                        validators[schema.id] = jsonschema.Draft202012Validator(relaxed(json.loads(schema.data)))
                    validators[schema.id].validate(content)
                if not topic.startswith("/robot/"):
                    continue
                _, _, robot, stream = topic.split("/", 3)
                if stream == "pose":
                    poses.setdefault(robot, []).append([content["x"], content["y"]])
                elif stream == "links":
                    links.setdefault(robot, []).append(content["links"])
                elif stream == "rank":
                    ranks.setdefault(robot, []).append(content.get("superior"))
    if not is_cut:
        with open(path, "rb") as file:
            reader = make_reader(file)
            summary = reader.get_summary()
            assert summary.statistics.message_count == sum(counts.values()), "the index counts others"
            assert summary.chunk_indexes, "there is no index"
            one = next(iter(poses))
            indexed = sum(1 for _ in reader.iter_messages(topics=[f"/robot/{one}/pose"]))
            assert indexed == len(poses[one]), "a topic is not found by the index"
    encodings = {channel.topic: [channel.message_encoding, schemas[channel.schema_id].name] for channel in channels.values()}
    found.update(counts=counts, topics=encodings, poses=poses, links=links, ranks=ranks, teams=newest.get("/json/teams"))
    json.dump(found, sys.stdout)


def relaxed(schema):
    """What viewers read has no null: a field that may be missing is one plain type there."""
    if isinstance(schema, dict):
        schema = {name: relaxed(part) for name, part in schema.items()}
        if isinstance(schema.get("type"), str):
            schema["type"] = [schema["type"], "null"]
    return schema


main(sys.argv[1], "--cut" in sys.argv[2:])
