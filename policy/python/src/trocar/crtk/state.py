"""What the arms of a run measure and are commanded, as CRTK over ROS 2: for rqt, PlotJuggler, ros2 bag and other recorders."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Sequence

from ..arms import arms_of, now_ns
from ..messages import ARM_NAMES, ArmFeedback, ArmSetpoint
from ..topics import Node
from .dds import DISCOVERY_S, Ros, RosError, arm_namespaces
from .messages import Header, JointState, Time
from .notes import Say, say_on_stderr

#: Rate of publication unless another one is asked for, Hz: the dVRK's own default.
RATE_HZ = 100.0

#: The dVRK's names of the joints.
_JOINTS = ["yaw", "pitch", "insertion", "roll", "wrist_pitch", "wrist_yaw"]

#: What is published of an arm.
_TOPICS = ("measured_js", "jaw/measured_js", "setpoint_js", "jaw/setpoint_js")

#: ROS 2's default depth.
_DEPTH = 10


class _Arm:
    """One arm's topics on both sides."""

    def __init__(self, node: Node, ros: Ros, arm: str, name: str) -> None:
        self._feedback = node.subscriber(ArmFeedback, arm)
        self._setpoints = node.subscriber(ArmSetpoint, arm)
        writers = [ros.writer(f"{name}/{topic}", JointState, depth=_DEPTH) for topic in _TOPICS]
        self._measured, self._measured_jaw, self._setpoint, self._setpoint_jaw = writers
        self.topics = [writer.topic for writer in writers]

    def publish(self) -> None:
        """Publishes what is new since the last time."""
        if (seen := self._feedback.newest()) is not None:
            header = _header(seen.stamp)
            self._measured.publish(JointState(header, _JOINTS, list(seen.position), list(seen.velocity), list(seen.effort)))
            self._measured_jaw.publish(JointState(header, ["jaw"], [seen.jaw_position], [seen.jaw_velocity], [seen.jaw_effort]))
        if (given := self._setpoints.newest()) is not None and given.enabled:
            header = _header(given.stamp)
            self._setpoint.publish(JointState(header, _JOINTS, list(given.position), list(given.velocity)))
            self._setpoint_jaw.publish(JointState(header, ["jaw"], [given.jaw_position], [given.jaw_velocity]))


def _header(stamp_ns: int) -> Header:
    """The header of what bears the time `stamp_ns` of ``trocar.now_ns``: ROS has the real-time clock."""
    return Header(Time.of(time.time_ns() - now_ns() + stamp_ns))


def bridge_state(
    names: Sequence[str],
    topics: str,
    *,
    rate_hz: float = RATE_HZ,
    domain: int | None = None,
    ending: threading.Event | None = None,
    say: Say = say_on_stderr,
) -> None:
    """Publishes the arms of the run `topics` under the namespaces `names`, `rate_hz` times a second, until `ending` is set.

    Of each arm ``measured_js`` and ``jaw/measured_js``, and while it is commanded with torque ``setpoint_js`` and ``jaw/setpoint_js``;
    nothing is published twice. Raises `RosError`, in particular if another process publishes one of them, and `trocar.TopicError`.
    """
    namespaces = arm_namespaces(names)
    if not 0 < rate_hz < math.inf:
        raise RosError(f"rate_hz = {rate_hz}: allowed is more than 0")
    ending = ending or threading.Event()
    ros, node = Ros(domain), Node(arms_of(topics))
    arms = [_Arm(node, ros, arm, name) for arm, name in zip(ARM_NAMES, namespaces)]
    time.sleep(DISCOVERY_S)
    _refuse_others(ros, arms)
    say(f"publishing {', '.join(names)} of topics {topics!r} in ROS domain {ros.domain}")
    next_s = time.monotonic()
    while not ending.is_set():
        for arm in arms:
            arm.publish()
        next_s = max(next_s + 1.0 / rate_hz, time.monotonic())
        time.sleep(max(next_s - time.monotonic(), 0.0))


def _refuse_others(ros: Ros, arms: Sequence[_Arm]) -> None:
    for topic in (topic for arm in arms for topic in arm.topics):
        for who in ros.publishers(topic):
            raise RosError(f"/{topic} is published by {who} already: choose another namespace with --as")
