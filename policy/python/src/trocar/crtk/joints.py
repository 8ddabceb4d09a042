"""JointState messages of an arm: which can be used, and when the newest one came."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..policy import Array
from .dds import Ros, RosError
from .messages import JointState
from .notes import UnusableError, Unused


@dataclass(frozen=True)
class Joints:
    """Usable measurements of some joints, rad and rad/s (m and m/s), N m (N)."""

    position: Array
    velocity: Array
    effort: Array
    #: No earlier than this did it come, by ``trocar.now_ns``.
    stamp_ns: int


def joints_of(message: JointState, count: int, stamp_ns: int) -> Joints:
    """What `message` measured of `count` joints; an effort that is not given is 0.

    Raises `UnusableError` if the header's stamp is zero, with which CRTK marks invalid data, and for lists of another length and numbers
    that are not finite.
    """
    if message.header.stamp.ns == 0:
        raise UnusableError("the header's stamp is zero, which marks invalid data")
    if len(message.name) not in (0, count):
        raise UnusableError(f"name has {len(message.name)} entries, expected {count} or none")
    return Joints(
        position=_list("position", message.position, count),
        velocity=_list("velocity", message.velocity, count),
        effort=_list("effort", message.effort or [0.0] * count, count),
        stamp_ns=stamp_ns,
    )


def _list(name: str, values: Sequence[float], count: int) -> Array:
    if len(values) != count:
        raise UnusableError(f"{name} has {len(values)} entries, expected {count}")
    array = np.array(values)
    if not np.isfinite(array).all():
        raise UnusableError(f"{name} is not finite")
    return array


class Measured:
    """The newest usable message of a JointState topic."""

    def __init__(self, ros: Ros, topic: str, count: int, unused: Unused) -> None:
        self._reader = ros.reader(topic, JointState)
        self._count = count
        self._unused = unused
        self._measured_ns = 0
        self._lacks_effort = False
        self.newest: Joints | None = None

    @property
    def topic(self) -> str:
        """Its topic."""
        return self._reader.topic

    def look(self, since_ns: int) -> None:
        """Takes what has come since the last look, which was at `since_ns`."""
        try:
            message = self._reader.newest()
            if message is None:
                return
            self._look_for_effort(message)
            measured = joints_of(message, self._count, since_ns)
            self._advance(message.header.stamp.ns)
            self.newest = measured
        except (UnusableError, RosError) as error:
            self._unused.add(self.topic, str(error))

    def _look_for_effort(self, message: JointState) -> None:
        if message.effort or self._lacks_effort or not message.header.stamp.ns:
            return
        self._lacks_effort = True
        self._unused.say(f"/{self.topic} has no effort, which is taken as 0: the limit on the jaw's closing effort can't act")

    def _advance(self, measured_ns: int) -> None:
        if measured_ns == self._measured_ns:
            raise UnusableError("the header's stamp is that of the message before: nothing was measured since")
        if measured_ns < self._measured_ns:
            raise UnusableError("the header's stamp goes back: if that clock was set back, start the bridge again")
        self._measured_ns = measured_ns
