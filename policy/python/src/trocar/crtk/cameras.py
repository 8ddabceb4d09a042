"""ROS images as cameras of a run."""

from __future__ import annotations

import threading
import time
from collections.abc import Mapping, Sequence

from cyclonedds.core import InstanceState, ReadCondition, SampleState, ViewState, WaitSet
from cyclonedds.util import duration

from ..arms import now_ns
from ..cameras import CameraPublisher
from .dds import Ros, RosError, ros_name
from .messages import CameraInfo, Header, Image
from .notes import PATIENCE_S, Say, UnusableError, Unused, say_on_stderr
from .pictures import Lens, Size, colour_of, fitted, lens_of

#: How far a header's stamp may lie in the past to be this machine's, ns.
_AGE_NS_MAX = 1_000_000_000

#: Longest time between two looks, s.
_LOOK_S = 0.1


def exposure_ns(header: Header) -> int:
    """When an image that has just come with `header` was exposed, by ``trocar.now_ns``.

    The header's stamp, if it lies in the last second of this machine's real-time clock. Else it is of another clock, or of none, and the
    image counts as exposed when it came.
    """
    age_ns = time.time_ns() - header.stamp.ns
    return now_ns() - (age_ns if 0 <= age_ns <= _AGE_NS_MAX else 0)


class CameraBridge:
    """The images of the ROS topic `source`, with the lens of the ``camera_info`` beside it, as the camera `name` on `topics`."""

    def __init__(self, ros: Ros, name: str, source: str, topics: str, *, size: Size | None = None, say: Say = say_on_stderr) -> None:
        self.name = name
        self.source = ros_name(source)
        self.images = ros.reader(self.source, Image, reliable=True)
        self._infos = ros.reader("/".join([*self.source.split("/")[:-1], "camera_info"]), CameraInfo)
        self._publisher = CameraPublisher(name, topics)
        self._size = size
        self._say = say
        self.unused = Unused(say)
        self._lens: tuple[Lens, tuple[int, int]] | None = None
        self.frames = 0

    def look(self) -> None:
        """Publishes the newest image, if one has come since the last look."""
        try:
            self._look_at_info()
            image = self.images.newest()
            if image is None:
                return self._publisher.keep_alive()
            colour, lens = colour_of(image), self._lens_for(image)
            if self._size is not None:
                colour, lens = fitted(colour, lens, self._size)
        except (UnusableError, RosError) as error:
            return self.unused.add(self.source, str(error))
        self._publisher.publish(colour, stamp_ns=exposure_ns(image.header), intrinsics=lens.intrinsics, distortion=lens.distortion)
        self.frames += 1
        if self.frames == 1:
            self._say(f"camera {self.name}: {colour.shape[1]}x{colour.shape[0]} pixels of /{self.source}")

    def _look_at_info(self) -> None:
        info = self._infos.newest()
        if info is None:
            return
        lens, lost = lens_of(info)
        if lost and self._lens is None:
            self._say(f"/{self._infos.topic}: {lost}")
        self._lens = lens, (int(info.width), int(info.height))

    def _lens_for(self, image: Image) -> Lens:
        if self._lens is None:
            return Lens()
        lens, size = self._lens
        if size != (image.width, image.height):
            self.unused.add(self._infos.topic, f"it is of {size[0]}x{size[1]} pixels, the images have {image.width}x{image.height}")
            return Lens()
        return lens


def cameras_of(texts: Sequence[str]) -> dict[str, str]:
    """ROS topics by camera, of ``CAMERA=TOPIC``."""
    pairs = [text.partition("=") for text in texts]
    for text, (name, equals, topic) in zip(texts, pairs):
        if not (name and equals and topic):
            raise RosError(f"{text!r}: expected CAMERA=TOPIC, as endoscope=/ECM/left/image_raw")
    if len({name for name, _, _ in pairs}) != len(pairs):
        raise RosError(f"{' '.join(texts)}: a camera is there twice")
    return {name: topic for name, _, topic in pairs}


def bridge_cameras(
    cameras: Mapping[str, str],
    topics: str,
    *,
    size: Size | None = None,
    domain: int | None = None,
    ending: threading.Event | None = None,
    say: Say = say_on_stderr,
) -> None:
    """Publishes the images of the ROS topics of `cameras` as these cameras on `topics` until `ending` is set.

    Raises `RosError` and `trocar.TopicError`, in particular for another publisher of a camera and for images that change their size.
    """
    ros = Ros(domain)
    bridges = [CameraBridge(ros, name, source, topics, size=size, say=say) for name, source in cameras.items()]
    fresh = ViewState.Any | SampleState.NotRead | InstanceState.Any
    conditions = [ReadCondition(raw, fresh) for bridge in bridges for raw in bridge.images.raw]
    waiting = WaitSet(ros.participant)
    for condition in conditions:
        waiting.attach(condition)
    patience_s = time.monotonic() + PATIENCE_S
    while not (ending and ending.is_set()):
        waiting.wait(duration(seconds=_LOOK_S))
        for bridge in bridges:
            bridge.look()
        if time.monotonic() >= patience_s:
            patience_s = float("inf")
            for bridge in bridges:
                if not bridge.frames:
                    say(f"waiting for /{bridge.source} (ROS domain {ros.domain})")
    for bridge in bridges:
        bridge.unused.sum_up()
