"""ROS images and lenses as Trocar's frames have them: 8-bit RGB, pixel centres at half-integers."""

from __future__ import annotations

import re
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .dds import RosError
from .messages import CameraInfo, Image
from .notes import UnusableError

#: Bytes a pixel, and where red, green and blue are among them.
_ENCODINGS = {
    "rgb8": (3, slice(0, 3)),
    "bgr8": (3, slice(2, None, -1)),
    "rgba8": (4, slice(0, 3)),
    "bgra8": (4, slice(2, None, -1)),
    "mono8": (1, slice(0, 1)),
}

#: Distortion models whose first coefficients are k1, k2, p1, p2.
_MODELS = ("plumb_bob", "rational_polynomial")


@dataclass(frozen=True)
class Lens:
    """fx, fy, cx, cy, pixels, and k1, k2, p1, p2; all 0 of a camera that is not calibrated."""

    intrinsics: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)
    distortion: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)


@dataclass(frozen=True)
class Size:
    """What frames are shrunk and cropped to, pixels."""

    width: int
    height: int

    @classmethod
    def parse(cls, text: str) -> Size:
        """`text` is ``512x512``."""
        found = re.fullmatch(r"([1-9]\d{0,4})x([1-9]\d{0,4})", text)
        if not found:
            raise RosError(f"size {text!r}: expected WIDTHxHEIGHT in pixels, as 512x512")
        return cls(int(found[1]), int(found[2]))


def colour_of(image: Image) -> NDArray[np.uint8]:
    """The pixels of `image`, (height, width, 3), red first.

    Raises `UnusableError` for other encodings than rgb8, bgr8, rgba8, bgra8 and mono8, and for data of another length than its size has.
    """
    if image.encoding not in _ENCODINGS:
        raise UnusableError(f"encoding {image.encoding!r}, allowed are {', '.join(_ENCODINGS)}")
    channels, colours = _ENCODINGS[image.encoding]
    width, height, step = int(image.width), int(image.height), int(image.step)
    if not (width and height) or step < channels * width or len(image.data) != step * height:
        raise UnusableError(f"{width}x{height} pixels of {channels} bytes in rows of {step} bytes came with {len(image.data)} bytes")
    rows = np.frombuffer(image.data, dtype=np.uint8).reshape(height, step)
    pixels = rows[:, : channels * width].reshape(height, width, channels)[:, :, colours]
    return np.broadcast_to(pixels, (height, width, 3))


def lens_of(info: CameraInfo) -> tuple[Lens, str | None]:
    """The lens, and what of it Trocar's frames don't have, if there is anything.

    ROS has the centre of the first pixel at 0, Trocar at one half.
    """
    fx, _, cx, _, fy, cy, *_ = info.k
    if not fx:
        return Lens(), "it is not calibrated"
    intrinsics = (fx, fy, cx + 0.5, cy + 0.5)
    if not any(info.d):
        return Lens(intrinsics), None
    if info.distortion_model not in _MODELS or len(info.d) < 4:
        return Lens(intrinsics), f"distortion of model {info.distortion_model!r} is left out"
    k1, k2, p1, p2, *higher = info.d
    return Lens(intrinsics, (k1, k2, p1, p2)), "k3 and what follows it are left out of its distortion" if any(higher) else None


def fitted(colour: NDArray[np.uint8], lens: Lens, size: Size) -> tuple[NDArray[np.uint8], Lens]:
    """`colour` and `lens` shrunk by the greatest whole factor that leaves `size`, each pixel a mean, and cropped to the middle.

    Raises `UnusableError` for an image that is smaller.
    """
    height, width = colour.shape[:2]
    factor = min(width // size.width, height // size.height)
    if factor < 1:
        raise UnusableError(f"{width}x{height} pixels, at least {size.width}x{size.height} are wanted")
    left, top = (width - factor * size.width) // 2, (height - factor * size.height) // 2
    middle = colour[top : top + factor * size.height, left : left + factor * size.width]
    total = np.full((size.height, size.width, 3), factor**2 // 2, dtype=np.uint32)
    for row in range(factor):
        for column in range(factor):
            total += middle[row::factor, column::factor]
    small = (total // factor**2).astype(np.uint8)
    fx, fy, cx, cy = lens.intrinsics
    if not fx:
        return small, lens
    return small, Lens((fx / factor, fy / factor, (cx - left) / factor, (cy - top) / factor), lens.distortion)
