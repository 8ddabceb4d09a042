"""Logs and results as pandas tables."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Iterable, Iterator, Mapping
from typing import Any

import pandas as pd
from google.protobuf import descriptor_pb2, descriptor_pool, message_factory
from google.protobuf.json_format import MessageToDict
from mcap.reader import make_reader

#: Schemas whose messages are pictures; their bytes are read only if their topics are named.
_PICTURES = ("foxglove.CompressedImage",)


class Log(Mapping[str, pd.DataFrame]):
    """A run's log: a table a topic, indexed by the seconds since the run began, and what the run says of itself in `metadata`.

    ``/psm1/measured_js`` and the like have a column a joint and quantity (``yaw.position``), poses the columns x, y, z, qx, qy, qz, qw;
    topics in JSON a column a key.
    """

    def __init__(self, tables: dict[str, pd.DataFrame], metadata: dict[str, dict[str, str]]) -> None:
        self._tables = tables
        self.metadata = metadata

    def __getitem__(self, topic: str) -> pd.DataFrame:
        return self._tables[topic]

    def __iter__(self) -> Iterator[str]:
        return iter(self._tables)

    def __len__(self) -> int:
        return len(self._tables)


def read_log(path: str | os.PathLike[str], topics: Iterable[str] | None = None) -> Log:
    """The log at `path`: all topics but pictures, or those that are named."""
    wanted = None if topics is None else list(topics)
    times: dict[str, list[int]] = {}
    rows: dict[str, list[dict[str, Any]]] = {}
    decoders: dict[int, Callable[[bytes], dict[str, Any]]] = {}
    begun: int | None = None
    with open(path, "rb") as file:
        reader = make_reader(file)
        metadata = {record.name: dict(record.metadata) for record in reader.iter_metadata()}
        for schema, channel, message in reader.iter_messages():
            begun = message.log_time if begun is None else min(begun, message.log_time)
            if schema is None or (wanted is None and schema.name in _PICTURES):
                continue
            if wanted is not None and channel.topic not in wanted:
                continue
            decode = decoders.get(channel.id)
            if decode is None:
                decode = decoders[channel.id] = _decoder(channel.message_encoding, schema)
            times.setdefault(channel.topic, []).append(message.log_time)
            rows.setdefault(channel.topic, []).append(decode(message.data))
    tables = {}
    for topic, stamps in times.items():
        seconds = pd.Index([1e-9 * (stamp - (begun or 0)) for stamp in stamps], name="seconds")
        tables[topic] = pd.DataFrame(rows[topic], index=seconds)
    return Log(tables, metadata)


def read_results(path: str | os.PathLike[str]) -> pd.DataFrame:
    """The result of ``trocar eval --json`` or ``trocar run --json`` at `path`: a row a trial; what holds for all is in ``attrs``."""
    with open(path, "rb") as file:
        result = json.load(file)
    if not isinstance(result, dict) or "task" not in result:
        raise ValueError(f"{os.fspath(path)}: no result of trocar eval or trocar run: an object with a key task is wanted")
    trials = result.pop("episodes", None)
    if trials is None:
        return pd.json_normalize(result)
    table = pd.json_normalize(trials)
    table.attrs.update(result)
    return table


def _decoder(encoding: str, schema: Any) -> Callable[[bytes], dict[str, Any]]:
    if encoding == "json":
        return lambda data: dict(json.loads(data))
    if encoding != "protobuf":
        raise ValueError(f"schema {schema.name}: messages in {encoding} can't be read")
    pool = descriptor_pool.DescriptorPool()
    for file in descriptor_pb2.FileDescriptorSet.FromString(schema.data).file:
        pool.Add(file)
    message = message_factory.GetMessageClass(pool.FindMessageTypeByName(schema.name))
    row = {"foxglove.JointStates": _joints, "foxglove.PoseInFrame": _pose}.get(schema.name, _anything)
    return lambda data: row(message.FromString(data))


def _joints(message: Any) -> dict[str, Any]:
    row: dict[str, Any] = {}
    for joint in message.joints:
        for quantity in ("position", "velocity", "acceleration", "effort"):
            if joint.HasField(quantity):
                row[f"{joint.name}.{quantity}"] = getattr(joint, quantity)
    return row


def _pose(message: Any) -> dict[str, Any]:
    place, turn = message.pose.position, message.pose.orientation
    return {"x": place.x, "y": place.y, "z": place.z, "qx": turn.x, "qy": turn.y, "qz": turn.z, "qw": turn.w}


def _anything(message: Any) -> dict[str, Any]:
    return dict(MessageToDict(message, preserving_proto_field_name=True))
