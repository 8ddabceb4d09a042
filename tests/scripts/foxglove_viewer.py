#!/usr/bin/env python3
"""Reads what a run tells Foxglove with code of others: the live server with `websockets`, a log with `mcap`.

    tests/scripts/foxglove_viewer.py ws://127.0.0.1:8765/?token=...   # trocar run --foxglove prints it
    tests/scripts/foxglove_viewer.py runs/a.mcap

Prints messages and schema of each topic, and fails unless every message decodes, also by the schema that Foxglove's own SDK has under that
name, with nothing left over, and all frames form one tree below `scene`.

Requirements: foxglove-sdk, mcap, mcap-protobuf-support and websockets.
"""

import asyncio
import base64
import collections.abc
import functools
import json
import struct
import sys

import foxglove.messages
from google.protobuf.descriptor_pb2 import FileDescriptorSet
from google.protobuf.descriptor_pool import DescriptorPool
from google.protobuf.message_factory import GetMessageClass
from google.protobuf.unknown_fields import UnknownFieldSet
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory
from websockets.asyncio.client import connect

SECONDS = 3.0

#: A run needs some time until it says anything.
PATIENCE_S = 60.0


def by_schema(name, files):
    """What decodes messages of a protobuf schema, whose files are a serialised FileDescriptorSet."""
    pool = DescriptorPool()
    for file in FileDescriptorSet.FromString(files).file:
        pool.Add(file)
    return GetMessageClass(pool.FindMessageTypeByName(name)).FromString


@functools.cache
def by_sdk(name):
    """What decodes messages of Foxglove's schema of this name, as its SDK has it."""
    schema = getattr(foxglove.messages, name.removeprefix("foxglove.")).get_schema()
    assert schema.name == name, schema.name
    return by_schema(name, schema.data)


def decoder(channel):
    """What decodes the messages of an advertised channel."""
    if channel["encoding"] == "json":
        return json.loads
    return by_schema(channel["schemaName"], base64.b64decode(channel["schema"]))


def unknown(message):
    """How many fields of a message, or of those in it, its schema does not have."""
    count = len(UnknownFieldSet(message))
    for field, value in message.ListFields():
        if field.message_type:
            count += sum(map(unknown, value if isinstance(value, collections.abc.Sequence) else [value]))
    return count


async def listen(url):
    """The messages of some seconds from the first on: topic, schema, message, bytes."""
    heard = []
    async with connect(url, subprotocols=["foxglove.sdk.v1"], max_size=None) as socket:
        assert json.loads(await socket.recv())["op"] == "serverInfo"
        channels = json.loads(await socket.recv())["channels"]
        wanted = [{"id": channel["id"], "channelId": channel["id"]} for channel in channels]
        await socket.send(json.dumps({"op": "subscribe", "subscriptions": wanted}))
        decoders = [decoder(channel) for channel in channels]
        try:
            async with asyncio.timeout(PATIENCE_S) as limit:
                async for message in socket:
                    if isinstance(message, str):
                        continue
                    if message[0] == 2:  # the time
                        continue
                    code, channel, _nanoseconds = struct.unpack_from("<BIQ", message)
                    assert code == 1, code
                    known = channels[channel]
                    if not heard:
                        limit.reschedule(asyncio.get_running_loop().time() + SECONDS)
                    data = message[13:]
                    heard.append((known["topic"], known["schemaName"], decoders[channel](data), data))
        except TimeoutError:
            pass
    return heard


def read(path):
    """The messages of a log: topic, schema, message, bytes."""
    with open(path, "rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        for schema, channel, message in reader.iter_messages():
            if channel.message_encoding == "json":
                decoded = json.loads(message.data)
            else:
                decoded = DecoderFactory().decoder_for(channel.message_encoding, schema)(message.data)
            yield channel.topic, schema.name, decoded, message.data


def check(messages):
    """Counts the messages, and puts the frames together."""
    counts = collections.Counter()
    parents = {}
    bent = set()
    for topic, schema, message, data in messages:
        counts[topic, schema] += 1
        if schema.startswith("foxglove.") and not isinstance(message, dict):
            message = by_sdk(schema)(data)
            assert unknown(message) == 0, f"{topic}: {schema} has other fields than the SDK's"
        if schema == "foxglove.SceneUpdate":
            for entity in message.entities:
                for shape in entity.triangles:
                    assert max(shape.indices) < len(shape.points) and len(shape.indices) % 3 == 0, entity.id
                    bent.add(entity.id)
        if schema == "foxglove.FrameTransforms":
            for transform in message.transforms:
                child, parent = transform.child_frame_id, transform.parent_frame_id
                assert parents.setdefault(child, parent) == parent, f"{child} has two parents"
    for (topic, schema), count in sorted(counts.items()):
        print(f"{count:7} {topic} {schema}")
    if bent:
        print(f"shapes that bend: {', '.join(sorted(bent))}")
    assert parents, "no frames"
    for frame in list(parents):
        top = frame
        for _ in parents:
            top = parents.get(top, top)
        assert top == "scene", f"{frame} is not below scene but below {top}"
    print(f"{len(parents)} frames in one tree: {', '.join(sorted(parents))}")


def main():
    place = sys.argv[1]
    check(asyncio.run(listen(place)) if place.startswith("ws://") else read(place))


if __name__ == "__main__":
    main()
