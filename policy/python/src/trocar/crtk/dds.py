"""ROS 2 topics without ROS: its names and QoS profiles over Eclipse Cyclone DDS."""

from __future__ import annotations

import os
import re
from collections.abc import Sequence
from typing import Any, Generic, TypeVar
from uuid import UUID

from cyclonedds.builtin import BuiltinDataReader, BuiltinTopicDcpsParticipant, BuiltinTopicDcpsPublication
from cyclonedds.core import DDSException, InstanceState, Policy, Qos
from cyclonedds.domain import DomainParticipant
from cyclonedds.pub import DataWriter
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic
from cyclonedds.util import duration

from ..messages import ARM_NAMES
from .messages import TYPE_HASHES

#: ROS 2's domain ids, as far as DDS has ports for them.
DOMAIN_MAX = 232

#: How long discovery gets to find other publishers, s.
DISCOVERY_S = 1.0

_NAME = re.compile(r"[A-Za-z_][A-Za-z0-9_]*(/[A-Za-z_][A-Za-z0-9_]*)*")
_ENDPOINTS_MAX = 256

M = TypeVar("M")


class RosError(RuntimeError):
    """A ROS 2 domain, name or topic can't be used."""


def domain_id() -> int:
    """What ROS_DOMAIN_ID says; 0 if it says nothing, as in ROS 2."""
    text = os.environ.get("ROS_DOMAIN_ID") or "0"
    if not text.isdecimal() or int(text) > DOMAIN_MAX:
        raise RosError(f"ROS_DOMAIN_ID = {text!r}: allowed are 0 to {DOMAIN_MAX}")
    return int(text)


def ros_name(text: str) -> str:
    """`text` without a leading '/', if it can name a topic or a namespace of ROS 2."""
    name = text.removeprefix("/")
    if not _NAME.fullmatch(name):
        raise RosError(f"{text!r} is no ROS name: use letters, digits and '_', with '/' between")
    return name


def arm_namespaces(names: Sequence[str]) -> list[str]:
    """The namespaces `names` of arms, of which a run has one or two."""
    if not 1 <= len(names) <= len(ARM_NAMES) or len(set(names)) != len(names):
        raise RosError(f"arms {' '.join(names)}: allowed are 1 to {len(ARM_NAMES)} different ones")
    return [ros_name(name) for name in names]


class Ros:
    """This process's participant in a ROS 2 domain, that of ROS_DOMAIN_ID if none is given.

    CYCLONEDDS_URI configures Cyclone DDS, as it does for ROS 2 itself.
    """

    def __init__(self, domain: int | None = None) -> None:
        self.domain = domain_id() if domain is None else domain
        try:
            self._participant = DomainParticipant(self.domain)
        except DDSException as error:
            hint = "does CYCLONEDDS_URI name an interface of this machine?"
            raise RosError(f"ROS domain {self.domain} can't be joined: {error}; {hint}") from error
        self._topics: dict[str, Any] = {}
        self._publications = BuiltinDataReader(self._participant, BuiltinTopicDcpsPublication)
        self._participants = BuiltinDataReader(self._participant, BuiltinTopicDcpsParticipant)
        self._writers: dict[UUID, tuple[str, UUID]] = {}

    @property
    def participant(self) -> Any:
        """The DDS participant, to wait on."""
        return self._participant

    def reader(self, topic: str, message: type[M], *, reliable: bool = False, latched: bool = False) -> Reader[M]:
        """A subscription of the newest message of `topic`, which matches any publisher.

        Best effort and volatile, which asks nothing of one; from a reliable publisher reliable, if `reliable`, so that what is lost comes
        again; from a latched one transient local, if `latched`, so that its last message is there too.
        """
        profiles = [_qos(message, reliable=reliable or latched, latched=latched)] if reliable or latched else []
        profiles.append(_qos(message, reliable=False, latched=False))
        raw = [DataReader(self._participant, self._topic(topic, message), profile) for profile in profiles]
        return Reader(raw, topic, message)

    def writer(self, topic: str, message: type[M], *, depth: int = 1) -> Writer[M]:
        """A publisher of `topic` with ROS 2's default profile (reliable, volatile), of the newest `depth` messages: it never waits."""
        profile = _qos(message, reliable=True, latched=False, depth=depth)
        return Writer(DataWriter(self._participant, self._topic(topic, message), profile), topic)

    def publishers(self, topic: str) -> list[str]:
        """Who else publishes `topic`, as far as discovery has found out; once for each publisher that it has."""
        self._discover()
        own = self._participant.get_guid()
        owners = [owner for name, owner in self._writers.values() if name == _dds_name(topic) and owner != own]
        return sorted(self._who(owner) for owner in owners)

    def _topic(self, topic: str, message: type[M]) -> Any:
        if topic not in self._topics:
            self._topics[topic] = Topic(self._participant, _dds_name(topic), message)
        return self._topics[topic]

    def _discover(self) -> None:
        while samples := self._publications.take(_ENDPOINTS_MAX):
            for sample in samples:
                if sample.sample_info.instance_state == InstanceState.Alive:
                    self._writers[sample.key] = sample.topic_name, sample.participant_key
                else:
                    self._writers.pop(sample.key, None)

    def _who(self, participant: UUID) -> str:
        for sample in self._participants.read(_ENDPOINTS_MAX):
            if sample.key == participant:
                known = {item.key: item.value for item in sample.qos if isinstance(item, Policy.Property)} if sample.qos else {}
                if "__ProcessName" in known:
                    return f"{known['__ProcessName']} (pid {known.get('__Pid', '?')} on {known.get('__Hostname', '?')})"
        return f"participant {participant}"


class Reader(Generic[M]):
    """A subscription of one topic, the most demanding one that matches a publisher first."""

    def __init__(self, raw: Sequence[Any], topic: str, message: type[M]) -> None:
        self.raw = raw
        self.topic = topic
        self._message = message

    def newest(self) -> M | None:
        """The newest message, if one has come since the last call; `RosError` if it can't be decoded."""
        # Of a publisher that several match each gets its messages.
        for raw, found in [(raw, self._take(raw)) for raw in self.raw]:
            if found is not None or (raw is not self.raw[-1] and raw.get_matched_publications()):
                return found
        return None

    def _take(self, raw: Any) -> M | None:
        try:
            samples = raw.take(_ENDPOINTS_MAX)
        except DDSException:
            raise
        except Exception as error:
            raise RosError(f"can't be decoded: {error}") from error
        valid = [sample for sample in samples if isinstance(sample, self._message)]
        return valid[-1] if valid else None


class Writer(Generic[M]):
    """A publisher of one topic."""

    def __init__(self, raw: Any, topic: str) -> None:
        self._raw = raw
        self.topic = topic

    def publish(self, message: M) -> None:
        """Publishes `message`."""
        self._raw.write(message)

    @property
    def matched(self) -> bool:
        """Whether a subscription is there."""
        return bool(self._raw.get_matched_subscriptions())

    def wait(self, timeout_s: float) -> bool:
        """Waits until all reliable subscriptions have what was published; False if they don't in time."""
        try:
            return bool(self._raw.wait_for_acks(duration(seconds=timeout_s)))
        except DDSException:
            return False


def _dds_name(topic: str) -> str:
    return f"rt/{topic}"


def _qos(message: type[Any], *, reliable: bool, latched: bool, depth: int = 1) -> Any:
    return Qos(
        Policy.Reliability.Reliable(duration(milliseconds=100)) if reliable else Policy.Reliability.BestEffort,
        Policy.Durability.TransientLocal if latched else Policy.Durability.Volatile,
        Policy.History.KeepLast(depth),
        Policy.Userdata(f"typehash={TYPE_HASHES[message]};".encode()),
    )
