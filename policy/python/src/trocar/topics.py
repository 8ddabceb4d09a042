"""Topics over iceoryx2 as Trocar opens them: one writer each, and the newest values win."""

from __future__ import annotations

import contextlib
import ctypes
import re
from collections.abc import Iterator
from typing import Any, Generic, TypeVar

import iceoryx2 as iox2
import numpy as np
from numpy.typing import NDArray

from .messages import FrameHeader, Message

# As hal/topics/src/node.rs has them: a service is opened with the qualities that it was created with, or not at all.
_SUBSCRIBERS_MAX = 3
_FRAMES_UNREAD = 1
_HELD_MAX = 2
_HISTORY = 1
_NODES_MAX = 16
_OPEN_TRIES = 200
_PREFIX = "trocar_"

#: 32-bit words of a frame a pixel: 4 bytes of depth, 3 of colour, 1 of instance id.
_WORDS_PER_PIXEL = 2

M = TypeVar("M", bound=Message)


class TopicError(RuntimeError):
    """A topic can't be opened, written or read."""


class Node:
    """This process's membership in the run `name`."""

    def __init__(self, name: str) -> None:
        if not re.fullmatch(r"[A-Za-z0-9_-]{1,100}", name):
            raise TopicError(f"{name!r} cannot name topics: use 1 to 100 letters, digits, '-' and '_'")
        iox2.set_log_level(iox2.LogLevel.Error)
        self.name = name
        self._config = iox2.config.default()
        self._config.global_cfg.prefix = iox2.FileName.new(_PREFIX)
        self._node = (
            iox2.NodeBuilder.new()
            .config(self._config)
            .signal_handling_mode(iox2.SignalHandlingMode.Disabled)
            .create(iox2.ServiceType.Ipc)
        )
        self._events = self._open_events()
        self._bell = self._events.notifier_builder().create()
        self.remove_dead()

    def remove_dead(self) -> None:
        """Frees what processes that died without cleaning up still hold."""
        self._node.blocking_cleanup_dead_nodes(iox2.Duration.from_secs(1))

    def is_alive(self, pid: int) -> bool:
        """Whether a node of the process `pid` is there and not known to be dead."""
        states = iox2.Node.list(iox2.ServiceType.Ipc, self._config)
        return any(not isinstance(state, iox2.NodeState.Dead) and _pid_of(state) == pid for state in states)

    def events(self) -> Events:
        """A place to wait for what the run's processes publish, for one thread."""
        return Events(self._events.listener_builder().create())

    def publisher(self, message: type[M], arm: str) -> Publisher[M]:
        """The only writer of the topic of `arm` that carries `message`."""
        topic = f"trocar/{self.name}/{arm}/{message.TOPIC}"
        service = self._open(topic, message, None, message.UNREAD)
        return Publisher(_published(topic, service.publisher_builder().max_loaned_samples(1)), topic, self._bell)

    def subscriber(self, message: type[M], arm: str) -> Subscriber[M]:
        """A reader of the topic of `arm` that carries `message`."""
        topic = f"trocar/{self.name}/{arm}/{message.TOPIC}"
        return Subscriber(self._subscribe(topic, message, None, message.UNREAD), message)

    def camera(self, camera: str) -> FrameSubscriber:
        """A reader of the frames of `camera`."""
        topic = f"trocar/{self.name}/{camera}/frame"
        return FrameSubscriber(self._subscribe(topic, iox2.Slice[ctypes.c_float], FrameHeader), topic)

    def camera_publisher(self, camera: str, pixels_max: int) -> FramePublisher:
        """The only writer of the frames of `camera`, of up to `pixels_max` pixels; reserves 88 bytes of shared memory a pixel."""
        topic = f"trocar/{self.name}/{camera}/frame"
        service = self._open(topic, iox2.Slice[ctypes.c_float], FrameHeader)
        builder = service.publisher_builder().max_loaned_samples(1).initial_max_slice_len(_WORDS_PER_PIXEL * pixels_max)
        return FramePublisher(_published(topic, builder), topic, pixels_max, self._bell)

    def _subscribe(self, topic: str, payload: Any, header: Any, unread: int = _FRAMES_UNREAD) -> Any:
        service = self._open(topic, payload, header, unread)
        try:
            return service.subscriber_builder().create()
        except iox2.SubscriberCreateError as error:
            raise TopicError(f"topic '{topic}' can't be read: {error}") from error

    def _open_events(self) -> Any:
        name = f"trocar/{self.name}/events"
        reason: Exception | None = None
        for _ in range(_OPEN_TRIES):
            builder = self._node.service_builder(iox2.ServiceName.new(name)).event()
            try:
                return builder.max_nodes(_NODES_MAX).max_notifiers(_NODES_MAX).max_listeners(_NODES_MAX).open_or_create()
            except iox2.EventOpenOrCreateError as error:
                reason = error
                # A peer may be creating or removing it.
                self._node.wait(iox2.Duration.from_millis(5))
        raise TopicError(f"event service '{name}' can't be opened: {reason}")

    def _open(self, topic: str, payload: Any, header: Any, unread: int = _FRAMES_UNREAD) -> Any:
        reason: Exception | None = None
        for _ in range(_OPEN_TRIES):
            builder = self._node.service_builder(iox2.ServiceName.new(topic)).publish_subscribe(payload)
            if header is not None:
                builder = builder.user_header(header)
            builder = (
                builder.enable_safe_overflow(True)
                .subscriber_max_buffer_size(unread)
                .subscriber_max_borrowed_samples(_HELD_MAX)
                .history_size(_HISTORY)
                .max_publishers(1)
                .max_subscribers(_SUBSCRIBERS_MAX)
                .max_nodes(_NODES_MAX)
            )
            try:
                return builder.open_or_create()
            except iox2.PublishSubscribeOpenOrCreateError as error:
                reason = error
                if "IncompatibleTypes" in str(error):
                    raise TopicError(
                        f"topic '{topic}' carries another type or layout of messages than "
                        f"{getattr(payload, 'NAME', 'frames')}: both sides must be of the same version"
                    ) from error
                # A peer may be creating or removing the same service.
                self._node.wait(iox2.Duration.from_millis(5))
        raise TopicError(f"topic '{topic}' can't be opened: {reason}")


def _published(topic: str, builder: Any) -> Any:
    try:
        return builder.create()
    except iox2.PublisherCreateError as error:
        raise TopicError(f"topic '{topic}' can't be published: {error}; does another process publish it?") from error


def _pid_of(state: Any) -> int:
    node = state._0
    node_id = node if isinstance(node, iox2.UniqueNodeId) else node.id
    if callable(node_id):
        node_id = node_id()
    return int(node_id.pid(iox2.ServiceType.Ipc))


class Events:
    """Waits for anything that is published in the run, by any process of it."""

    def __init__(self, raw: Any) -> None:
        self._raw = raw

    def wait(self, at_most_s: float) -> None:
        """Waits until something is published, or that long. There may be nothing new on the topics that one reads."""
        # A signal cuts it short, with an error.
        with contextlib.suppress(iox2.ListenerWaitError):
            self._raw.timed_wait(iox2.Duration.from_nanos(int(at_most_s * 1e9)))


class Publisher(Generic[M]):
    """Writes the messages of one topic."""

    def __init__(self, raw: Any, topic: str, bell: Any) -> None:
        self._raw = raw
        self._topic = topic
        self._bell = bell

    def publish(self, message: M) -> None:
        """Publishes `message` and wakes who waits; never waits for readers."""
        self._raw.send_copy(message)
        self._bell.notify()

    def keep_alive(self) -> None:
        """Hands the newest message to readers that have come since."""
        self._raw.update_connections()


class Subscriber(Generic[M]):
    """Reads the messages of one topic."""

    def __init__(self, raw: Any, message: type[M]) -> None:
        self._raw = raw
        self._message = message

    def newest(self) -> M | None:
        """The newest message, if one has come since the last call."""
        newest: M | None = None
        for message in self.unread():
            newest = message
        return newest

    def unread(self) -> Iterator[M]:
        """The messages that have come since the last call, the oldest first; at most the newest `UNREAD` of its type."""
        while (sample := self._raw.receive()) is not None:
            message = self._message.from_buffer_copy(sample.payload().contents)
            sample.delete()
            yield message


class FramePublisher:
    """Writes the frames of one camera."""

    def __init__(self, raw: Any, topic: str, pixels_max: int, bell: Any) -> None:
        self._raw = raw
        self._topic = topic
        self._pixels_max = pixels_max
        self._bell = bell

    def publish(
        self,
        header: FrameHeader,
        colour: NDArray[np.uint8],
        depth_m: NDArray[np.float32] | None = None,
        instance: NDArray[np.uint8] | None = None,
    ) -> None:
        """Publishes planes of the size that `header` has, depth and instance ids as zeros if not given, and wakes who waits."""
        width, height = header.intrinsics.width, header.intrinsics.height
        pixels = width * height
        if not 0 < pixels <= self._pixels_max:
            raise TopicError(f"topic '{self._topic}': a frame of {width}x{height} pixels, allowed are 1 to {self._pixels_max} pixels")
        loan = self._raw.loan_slice_uninit(_WORDS_PER_PIXEL * pixels)
        ctypes.memmove(loan.user_header_ptr, ctypes.byref(header), ctypes.sizeof(header))
        words = _WORDS_PER_PIXEL * pixels
        raw = np.frombuffer((ctypes.c_uint8 * (4 * words)).from_address(loan.payload_ptr), dtype=np.uint8)
        pairs: list[tuple[NDArray[Any], NDArray[Any] | None]] = list(zip(_planes(raw, width, height), (colour, depth_m, instance)))
        for into, plane in pairs:
            if plane is not None and plane.shape != into.shape:
                raise TopicError(f"topic '{self._topic}': a plane of shape {plane.shape} came with a frame of {width}x{height} pixels")
            into[...] = 0 if plane is None else plane
        loan.assume_init().send()
        self._bell.notify()

    def keep_alive(self) -> None:
        """Hands the newest frame to readers that have come since."""
        self._raw.update_connections()


class FrameSubscriber:
    """Reads the frames of one camera where the writer put them."""

    def __init__(self, raw: Any, topic: str) -> None:
        self._raw = raw
        self._topic = topic
        self._sample: Any = None
        self.header: FrameHeader | None = None

    def look(self) -> bool:
        """Takes the newest frame, if one has come since the last call; the one before is given back."""
        fresh = False
        while self._raw.has_samples():
            self.drop()
            self._sample = self._raw.receive()
            fresh = self._sample is not None
        if fresh:
            self.header = FrameHeader.from_buffer_copy(self._sample.user_header().contents)
        return fresh

    def drop(self) -> None:
        """Gives the frame back."""
        if self._sample is not None:
            self._sample.delete()
        self._sample = None
        self.header = None

    def planes(self) -> tuple[NDArray[np.uint8], NDArray[np.float32], NDArray[np.uint8]]:
        """Colour, depth and instance ids of the frame, where they lie."""
        if self._sample is None or self.header is None:
            raise TopicError(f"topic '{self._topic}' has published no frame")
        width, height = self.header.intrinsics.width, self.header.intrinsics.height
        pixels = width * height
        # The length of the payload's own slice is in bytes here, that of the transport's header in words.
        words = self._sample.header.number_of_elements
        if words != _WORDS_PER_PIXEL * pixels:
            raise TopicError(f"topic '{self._topic}': a frame of {width}x{height} pixels came with {words} words")
        raw = np.frombuffer((ctypes.c_uint8 * (8 * pixels)).from_address(self._sample.payload_ptr), dtype=np.uint8)
        raw.flags.writeable = False
        return _planes(raw, width, height)


def _planes(
    raw: NDArray[np.uint8], width: int, height: int
) -> tuple[NDArray[np.uint8], NDArray[np.float32], NDArray[np.uint8]]:
    """Colour, depth and instance ids of a frame whose bytes are `raw`."""
    pixels = width * height
    depth = raw[: 4 * pixels].view(np.float32).reshape(height, width)
    colour = raw[4 * pixels : 7 * pixels].reshape(height, width, 3)
    instance = raw[7 * pixels :].reshape(height, width)
    return colour, depth, instance
