"""A camera of one's own: frames on the topics of a run, where ``trocar run --topics NAME`` and policies look for them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from .arms import now_ns
from .messages import Distortion, FrameHeader, Intrinsics
from .topics import Node, TopicError

#: Where a camera is of which nothing else is known: x, y, z, m, and a unit quaternion x, y, z, w.
_AT_ORIGIN = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0)


class CameraPublisher:
    """The only publisher of the camera `name` on `topics`."""

    def __init__(self, name: str, topics: str = "cameras") -> None:
        self._name = name
        self._node = Node(topics)
        self._shape: tuple[int, int] | None = None
        self._sequence = 0

    def publish(
        self,
        colour: NDArray[np.uint8],
        *,
        stamp_ns: int | None = None,
        intrinsics: Sequence[float] = (0.0, 0.0, 0.0, 0.0),
        distortion: Sequence[float] = (0.0, 0.0, 0.0, 0.0),
        depth_m: NDArray[np.float32] | None = None,
        instance: NDArray[np.uint8] | None = None,
        camera_in_scene: Sequence[float] = _AT_ORIGIN,
    ) -> None:
        """Publishes a frame; the first one sets the size of all.

        `colour` is sRGB, 8 bits, (height, width, 3), `depth_m` the distance along the camera's z axis, m, 0 where there is none, and
        `instance` the id of what is seen, 0 for the background: all of them 0 if not given. `stamp_ns` is when it was exposed, by
        ``trocar.now_ns`` (CLOCK_MONOTONIC), now if not given: a run refuses frames that are older than 0.5 s or more than 40 ms ahead.
        `intrinsics` are fx, fy, cx, cy, pixels, with pixel centres at half-integers, 0 if the camera is not calibrated, `distortion`
        OpenCV's k1, k2, p1, p2, and `camera_in_scene` its pose: x right, y down, z along the view.

        Raises `TopicError`: another publisher of this camera, a frame of another size, a plane of another shape or type.
        """
        image = np.asarray(colour)
        if image.ndim != 3 or image.shape[2] != 3 or image.dtype != np.uint8:
            raise TopicError(f"camera {self._name}: colour of shape {image.shape}, {image.dtype}: expected (height, width, 3), uint8")
        height, width = image.shape[:2]
        if self._shape is None:
            self._publisher = self._node.camera_publisher(self._name, height * width)
            self._shape = height, width
        if self._shape != (height, width):
            raise TopicError(f"camera {self._name}: a frame of {width}x{height} pixels after those of {self._shape[1]}x{self._shape[0]}")
        self._sequence += 1
        header = FrameHeader(
            stamp=now_ns() if stamp_ns is None else stamp_ns,
            sequence=self._sequence,
            intrinsics=Intrinsics(width, height, *_four(intrinsics), Distortion(*_four(distortion))),
            position_m=tuple(camera_in_scene[:3]),
            rotation_xyzw=tuple(camera_in_scene[3:]),
        )
        depth = None if depth_m is None else np.asarray(depth_m, dtype=np.float32)
        ids = None if instance is None else np.asarray(instance, dtype=np.uint8)
        self._publisher.publish(header, image, depth, ids)

    def keep_alive(self) -> None:
        """Hands the newest frame to readers that have come since: worth calling where frames come seldom."""
        if self._shape is not None:
            self._publisher.keep_alive()


def _four(numbers: Sequence[float]) -> list[float]:
    if len(numbers) != 4:
        raise TopicError(f"{len(numbers)} numbers of a lens: expected 4")
    return [float(number) for number in numbers]
