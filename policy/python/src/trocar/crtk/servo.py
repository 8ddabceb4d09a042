"""The set-points of one arm as CRTK's servo_jp, for the arm and for its jaw."""

from __future__ import annotations

import time

from ..arms import ArmCommand
from ..policy import Array
from .dds import Ros
from .messages import Header, JointState, Time

#: For how long the set-point of an arm that has come to rest is sent again, ns. From then on it is held without: nobody else is in the way
#: of ours when no run is there.
_REPEATED_NS = 100_000_000

#: A run whose arm has rested that long is over, or has lost nothing if it is not, ns.
_OVER_NS = 1_000_000_000

#: Longest wait for the last set-points to arrive, s.
_ACKNOWLEDGED_S = 1.0


class Servo:
    """Publishes the set-points of the arm `name`: positions with velocities, which the dVRK feeds forward."""

    def __init__(self, ros: Ros, name: str) -> None:
        self._joints = ros.writer(f"{name}/servo_jp", JointState)
        self._jaw = ros.writer(f"{name}/jaw/servo_jp", JointState)
        self._given: ArmCommand | None = None
        self._since_ns = 0
        self._sent: ArmCommand | None = None

    @property
    def topics(self) -> tuple[str, str]:
        """What it publishes."""
        return self._joints.topic, self._jaw.topic

    @property
    def unheard(self) -> list[str]:
        """Those to which nobody subscribes."""
        return [writer.topic for writer in (self._joints, self._jaw) if not writer.matched]

    @property
    def is_over(self) -> bool:
        """Whether nobody commands the arm: without torque, or at rest for long."""
        return self._given is None or not self._given.enabled or self._rested_ns >= _OVER_NS

    def follow(self, command: ArmCommand | None, *, withheld: bool) -> None:
        """Publishes `command`, unless it is without torque, has been at rest for 0.1 s already, or is `withheld`."""
        if not _repeats(command, self._given):
            self._since_ns = command.stamp_ns if command else 0
        self._given = command
        if withheld:
            self._sent = None
        elif command is None or not command.enabled:
            self.hold()
        elif self._rested_ns < _REPEATED_NS:
            self._publish(command.position, command.velocity, command.jaw_position, command.jaw_velocity)
            self._sent = command

    def hold(self) -> None:
        """Leaves no velocity behind: an arm that was last sent one is sent its last position without, since it would keep both for good."""
        last, self._sent = self._sent, None
        if last is not None and (last.velocity.any() or last.jaw_velocity):
            self._publish(last.position, 0.0 * last.velocity, last.jaw_position, 0.0)

    def close(self) -> None:
        """Holds, and waits until that has arrived, for 1 s at most."""
        self.hold()
        for writer in (self._joints, self._jaw):
            writer.wait(_ACKNOWLEDGED_S)

    @property
    def _rested_ns(self) -> int:
        return self._given.stamp_ns - self._since_ns if self._given else 0

    def _publish(self, position: Array, velocity: Array, jaw_position: float, jaw_velocity: float) -> None:
        header = Header(Time.of(time.time_ns()))
        self._joints.publish(JointState(header, [], position.tolist(), velocity.tolist()))
        self._jaw.publish(JointState(header, [], [jaw_position], [jaw_velocity]))


def _repeats(command: ArmCommand | None, before: ArmCommand | None) -> bool:
    """Whether `command` is at rest where `before` was."""
    if command is None or before is None or not command.enabled or not before.enabled:
        return False
    if not (command.rests and before.rests):
        return False
    return command.jaw_position == before.jaw_position and bool((command.position == before.position).all())
