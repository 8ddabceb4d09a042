"""The set-points of one arm as CRTK's servo_jp, for the arm and for its jaw."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Iterable, Sequence

from ..arms import ArmCommand
from .dds import Ros, Writer
from .messages import Header, JointState, Time

#: For how long the set-point of an arm that has come to rest is sent again, ns. From then on it is held without: nobody else is in the way
#: of ours when no run is there.
_REPEATED_NS = 100_000_000

#: A run whose arm has rested that long is over, or has lost nothing if it is not, ns.
_OVER_NS = 1_000_000_000

#: Longest wait for the last set-points to arrive, s.
_ACKNOWLEDGED_S = 1.0


class _SetPoints:
    """One topic of set-points."""

    def __init__(self, ros: Ros, topic: str) -> None:
        self.writer = ros.writer(topic, JointState)
        self._position: list[float] = []
        self._moves = False

    def send(self, position: list[float], velocity: list[float]) -> None:
        """Publishes a set-point."""
        # An exception leaves open whether this one was sent, so it is noted before.
        self._position = position
        self._moves = self._moves or any(velocity)
        self.writer.publish(JointState(Header(Time.of(time.time_ns())), [], position, velocity))
        self._moves = any(velocity)

    def hold(self) -> None:
        """Sends the last position without velocity, if a velocity may be left there."""
        if self._moves:
            self.send(self._position, [0.0] * len(self._position))


class Servo:
    """Publishes the set-points of the arm `name`: positions with velocities, which the dVRK feeds forward."""

    def __init__(self, ros: Ros, name: str) -> None:
        self._joints = _SetPoints(ros, f"{name}/servo_jp")
        self._jaw = _SetPoints(ros, f"{name}/jaw/servo_jp")
        self._given: ArmCommand | None = None
        self._since_ns = 0

    @property
    def writers(self) -> list[Writer[JointState]]:
        """What it publishes with."""
        return [self._joints.writer, self._jaw.writer]

    @property
    def topics(self) -> list[str]:
        """What it publishes."""
        return [writer.topic for writer in self.writers]

    @property
    def unheard(self) -> list[str]:
        """Those to which nobody subscribes."""
        return [writer.topic for writer in self.writers if not writer.matched]

    @property
    def is_over(self) -> bool:
        """Whether nobody commands the arm: without torque, or at rest for long."""
        return self._given is None or not self._given.enabled or self._rested_ns >= _OVER_NS

    def follow(self, command: ArmCommand | None, *, withheld: bool) -> None:
        """Publishes `command`, unless it has been at rest for 0.1 s already. If it is without torque or `withheld`, the arm is held."""
        if not _repeats(command, self._given):
            self._since_ns = command.stamp_ns if command else 0
        self._given = command
        if withheld or command is None or not command.enabled:
            self.hold()
        elif self._rested_ns < _REPEATED_NS:
            self._joints.send(command.position.tolist(), command.velocity.tolist())
            self._jaw.send([command.jaw_position], [command.jaw_velocity])

    def hold(self) -> None:
        """Leaves no velocity behind: an arm that was last sent one is sent its last position once without, since it keeps both for good."""
        _hold_each([self._joints, self._jaw])

    @property
    def _rested_ns(self) -> int:
        return self._given.stamp_ns - self._since_ns if self._given else 0


def close_all(servos: Sequence[Servo]) -> None:
    """Holds every arm, and only then waits until that has arrived, for 1 s at most; raises what was raised last."""
    try:
        _hold_each(servos)
    finally:
        try:
            # Once more, for what an interruption came upon.
            _hold_each(servos)
        finally:
            _wait(servos)


def _hold_each(held: Iterable[Servo | _SetPoints]) -> None:
    """Holds each of `held`, whatever becomes of the others."""
    with contextlib.ExitStack() as holding:
        for one in held:
            holding.callback(one.hold)


def _wait(servos: Sequence[Servo]) -> None:
    end_s = time.monotonic() + _ACKNOWLEDGED_S
    for writer in (writer for servo in servos for writer in servo.writers):
        writer.wait(max(end_s - time.monotonic(), 0.0))


def _repeats(command: ArmCommand | None, before: ArmCommand | None) -> bool:
    """Whether `command` is at rest where `before` was."""
    if command is None or before is None or not command.enabled or not before.enabled:
        return False
    if not (command.rests and before.rests):
        return False
    return command.jaw_position == before.jaw_position and bool((command.position == before.position).all())
