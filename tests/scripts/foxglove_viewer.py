#!/usr/bin/env python3
"""Reads what a run tells Foxglove with code of others: the live server with `websockets`, a log with `mcap`.

    tests/scripts/foxglove_viewer.py ws://127.0.0.1:8765/?token=...   # trocar run --foxglove prints it
    tests/scripts/foxglove_viewer.py runs/a.mcap

Prints messages and schema of each topic, and fails unless every message decodes and all frames form one tree below `scene`.

Requirements: mcap, mcap-protobuf-support and websockets.
"""

import asyncio
import base64
import collections
import json
import struct
import sys

from google.protobuf.descriptor_pb2 import FileDescriptorSet
from google.protobuf.descriptor_pool import DescriptorPool
from google.protobuf.message_factory import GetMessageClass
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory
from websockets.asyncio.client import connect

SECONDS = 3.0


def decoder(channel):
    """What decodes the messages of an advertised channel."""
    if channel["encoding"] == "json":
        return json.loads
    pool = DescriptorPool()
    for file in FileDescriptorSet.FromString(base64.b64decode(channel["schema"])).file:
        pool.Add(file)
    return GetMessageClass(pool.FindMessageTypeByName(channel["schemaName"])).FromString


async def listen(url):
    """The messages of some seconds: topic, schema, message."""
    heard = []
    async with connect(url, subprotocols=["foxglove.sdk.v1"], max_size=None) as socket:
        assert json.loads(await socket.recv())["op"] == "serverInfo"
        channels = json.loads(await socket.recv())["channels"]
        wanted = [{"id": channel["id"], "channelId": channel["id"]} for channel in channels]
        await socket.send(json.dumps({"op": "subscribe", "subscriptions": wanted}))
        decoders = [decoder(channel) for channel in channels]
        try:
            async with asyncio.timeout(SECONDS):
                async for message in socket:
                    if isinstance(message, str):
                        continue
                    if message[0] == 2:  # the time
                        continue
                    code, channel, _nanoseconds = struct.unpack_from("<BIQ", message)
                    assert code == 1, code
                    known = channels[channel]
                    heard.append((known["topic"], known["schemaName"], decoders[channel](message[13:])))
        except TimeoutError:
            pass
    return heard


def read(path):
    """The messages of a log: topic, schema, message."""
    with open(path, "rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        for schema, channel, message in reader.iter_messages():
            if channel.message_encoding == "json":
                decoded = json.loads(message.data)
            else:
                decoded = DecoderFactory().decoder_for(channel.message_encoding, schema)(message.data)
            yield channel.topic, schema.name, decoded


def check(messages):
    """Counts the messages, and puts the frames together."""
    counts = collections.Counter()
    parents = {}
    for topic, schema, message in messages:
        counts[topic, schema] += 1
        if schema == "foxglove.FrameTransforms":
            for transform in message.transforms:
                child, parent = transform.child_frame_id, transform.parent_frame_id
                assert parents.setdefault(child, parent) == parent, f"{child} has two parents"
    for (topic, schema), count in sorted(counts.items()):
        print(f"{count:7} {topic} {schema}")
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
