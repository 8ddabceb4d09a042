"""Plain CDR, as ROS 2 sends it, of images and set-points: Cyclone DDS takes several times as long for them in Python."""

from __future__ import annotations

import struct
from collections.abc import Sequence

#: The encapsulation header of little-endian plain CDR.
_HEADER = b"\0\1\0\0"


class CdrReader:
    """Reads a message from its encapsulation header on; `struct.error` and `IndexError` for what ends too early."""

    def __init__(self, data: bytes) -> None:
        self._body = memoryview(data)[len(_HEADER) :]
        # The lowest bit of the representation: CDR_BE is 0, CDR_LE is 1.
        self._order = "<" if data[1] & 1 else ">"
        self._at = 0

    def number(self, kind: str) -> int:
        """An integer of the `struct` format `kind`."""
        size = struct.calcsize(kind)
        at = self._at + -self._at % size
        self._at = at + size
        (value,) = struct.unpack_from(self._order + kind, self._body, at)
        return int(value)

    def octets(self) -> memoryview:
        """A sequence of bytes, where it lies."""
        count = self.number("I")
        found = self._body[self._at : self._at + count]
        if len(found) != count:
            raise IndexError(f"{count} bytes are announced, {len(found)} are there")
        self._at += count
        return found

    def text(self) -> str:
        """A string."""
        return bytes(self.octets()).rstrip(b"\0").decode(errors="replace")


class CdrWriter:
    """Writes a message, its encapsulation header first."""

    def __init__(self) -> None:
        self._body = bytearray()

    def number(self, kind: str, value: int) -> None:
        """An integer of the `struct` format `kind`."""
        self._align(struct.calcsize(kind))
        self._body += struct.pack(f"<{kind}", value)

    def text(self, value: str) -> None:
        """A string."""
        encoded = value.encode() + b"\0"
        self.number("I", len(encoded))
        self._body += encoded

    def texts(self, values: Sequence[str]) -> None:
        """A sequence of strings."""
        self.number("I", len(values))
        for value in values:
            self.text(value)

    def doubles(self, values: Sequence[float]) -> None:
        """A sequence of numbers."""
        self.number("I", len(values))
        if values:
            self._align(8)
            self._body += struct.pack(f"<{len(values)}d", *values)

    def message(self) -> bytes:
        """All of it."""
        return _HEADER + bytes(self._body)

    def _align(self, size: int) -> None:
        self._body += bytes(-len(self._body) % size)
