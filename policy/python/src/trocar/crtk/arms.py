"""Arms that speak CRTK over ROS 2, behind the controller: those of a dVRK, or of a simulator."""

from __future__ import annotations

import contextlib
import threading
import time
from collections.abc import Sequence

from ..arms import ArmCommand, ArmState, now_ns, serve_arms
from ..messages import JOINT_COUNT
from .dds import DISCOVERY_S, Ros, RosError, arm_namespaces
from .joints import Measured
from .notes import PATIENCE_S, Say, Unused, say_on_stderr
from .readiness import Latch, Operating
from .servo import Servo, close_all

#: Time between two looks for what should not be, s.
_WATCH_S = 1.0

#: Time between two looks while waiting, s.
_LOOK_S = 0.005

#: An arm that was measured longer ago is not there, ns.
_AGE_NS_MAX = 500_000_000


class _Arm:
    """One arm's topics."""

    def __init__(self, ros: Ros, name: str, unused: Unused, say: Say) -> None:
        self.name = name
        self._ros = ros
        self._say = say
        self._joints = Measured(ros, f"{name}/measured_js", JOINT_COUNT, unused)
        self._jaw = Measured(ros, f"{name}/jaw/measured_js", 1, unused)
        self._operating = Operating(ros, f"{name}/operating_state", unused)
        self._latch = Latch()
        self.servo = Servo(ros, name)

    def look(self, since_ns: int) -> bool:
        """Takes what has come since the last look, which was at `since_ns`; whether the operating state has changed."""
        for measured in (self._joints, self._jaw):
            measured.look(since_ns)
        return self._operating.look()

    def missing(self) -> str | None:
        """The topics on which nothing usable comes, and those of set-points to which nobody subscribes, if there are any."""
        oldest_ns = now_ns() - _AGE_NS_MAX
        missing = [f"/{topic.topic}" for topic in (self._joints, self._jaw) if topic.newest is None or topic.newest.stamp_ns < oldest_ns]
        if self._operating.newest is None:
            missing.append(f"/{self._operating.topic}")
        missing += [f"a subscriber of /{topic}" for topic in self.servo.unheard]
        return " and ".join(missing) or None

    def lacking(self) -> str | None:
        """What must come about before the arm is served, if anything must."""
        missing = self.missing()
        if missing or (self._operating.fault is None and not self._operating.is_busy):
            return missing
        return f"/{self._operating.topic} to be ENABLED, homed, not busy; it is {self._operating}"

    def doubled(self) -> list[str]:
        """Who publishes what one alone should."""
        found = []
        for topic in self.servo.topics:
            if others := self._ros.publishers(topic):
                found.append(f"/{topic} is published by {' and '.join(others)} too, commands would come in turn: end it, or this bridge")
        for topic in (self._joints.topic, self._jaw.topic):
            if len(publishers := self._ros.publishers(topic)) > 1:
                found.append(f"/{topic} is published by {' and '.join(publishers)}, measurements would come in turn: end all but one")
        return found

    def exchange(self, command: ArmCommand | None, since_ns: int, begun_ns: int) -> ArmState:
        """Passes `command` on, if the arm may be commanded, and gives what was measured."""
        if self.look(since_ns):
            self._say(f"{self.name} is {self._operating}")
        if self._latch.update(self._operating.fault, begun_ns, run_over=self.servo.is_over):
            fault = self._latch.fault
            news = f"fault {fault:#06x} ({fault.name}), no set-point is sent" if fault else "ready for another run"
            self._say(f"{self.name}: {news}")
        self.servo.follow(command, withheld=self._latch.fault is not None)
        return self._state()

    def _state(self) -> ArmState:
        joints, jaw = self._joints.newest, self._jaw.newest
        if joints is None or jaw is None:
            raise RosError(f"{self.name} has not been measured")
        return ArmState(
            joints.position,
            joints.velocity,
            joints.effort,
            float(jaw.position[0]),
            float(jaw.velocity[0]),
            float(jaw.effort[0]),
            stamp_ns=min(joints.stamp_ns, jaw.stamp_ns),
            fault=None if self._latch.fault is None else (0, int(self._latch.fault)),
        )


class CrtkArms:
    """The arms `names` (``PSM1``) of a ROS 2 domain, in the order of Trocar's ``psm1``, ``psm2``: `trocar.Arms` for `trocar.serve_arms`.

    Subscribes to ``NAME/measured_js`` (yaw, pitch, insertion, roll, wrist pitch, wrist yaw; rad, m), ``NAME/jaw/measured_js`` and
    ``NAME/operating_state``, publishes ``NAME/servo_jp`` and ``NAME/jaw/servo_jp``. It never enables, homes or disables an arm.

    A measurement's time is when its message came. An arm that is not ENABLED and homed has a `Fault`; it is sent its last position without
    velocity, and then nothing until it is both again and another run commands it. Raises `RosError`: no such domain, no such name, another
    publisher of a set-point, or two of a measurement.
    """

    def __init__(
        self,
        names: Sequence[str],
        *,
        domain: int | None = None,
        ending: threading.Event | None = None,
        say: Say = say_on_stderr,
    ) -> None:
        namespaces = arm_namespaces(names)
        self._say = say
        self._ending = ending or threading.Event()
        self._ros = Ros(domain)
        self._unused = Unused(say)
        self._arms = [_Arm(self._ros, name, self._unused, say) for name in namespaces]
        self._begun_s = time.monotonic()
        self._ready = False
        self._looked_ns = now_ns()
        self._watched_s = 0.0
        self._warnings: list[str] = []

    def wait(self) -> bool:
        """Waits until every arm is measured, ENABLED, homed and not busy, and says what it waits for; False if `ending` was set before.

        Raises `RosError` if another process publishes an arm's set-points, or two publish what it measures.
        """
        said = None
        while not self._ending.is_set():
            waited_s = time.monotonic() - self._begun_s
            lacking = self._lacking()
            if waited_s >= DISCOVERY_S:
                self._refuse_doubled()
                if lacking is None:
                    self._ready = True
                    return True
            if lacking is not None and lacking != said and waited_s >= PATIENCE_S:
                said = lacking
                self._say(f"waiting for {lacking} (ROS domain {self._ros.domain})")
            time.sleep(_LOOK_S)
        return False

    def exchange(self, commands: Sequence[ArmCommand] | None) -> list[ArmState]:
        """See `trocar.Arms`. The first call waits until the arms are ready; `KeyboardInterrupt` if `ending` was set before."""
        if not self._ready and not self.wait():
            raise KeyboardInterrupt
        begun_ns = now_ns()
        since_ns, self._looked_ns = self._looked_ns, begun_ns
        given: Sequence[ArmCommand | None] = commands or [None] * len(self._arms)
        states = [arm.exchange(command, since_ns, begun_ns) for arm, command in zip(self._arms, given)]
        self._watch()
        return states

    def close(self) -> None:
        """Leaves the arms at rest: one that was last sent a velocity is sent its last position without."""
        try:
            close_all([arm.servo for arm in self._arms])
        finally:
            self._unused.sum_up()

    def _lacking(self) -> str | None:
        since_ns, self._looked_ns = self._looked_ns, now_ns()
        for arm in self._arms:
            arm.look(since_ns)
        lacking = [arm.lacking() for arm in self._arms]
        return "; ".join(text for text in lacking if text) or None

    def _doubled(self) -> list[str]:
        return [text for arm in self._arms for text in arm.doubled()]

    def _refuse_doubled(self) -> None:
        if doubled := self._doubled():
            raise RosError("; ".join(doubled))

    def _watch(self) -> None:
        """Says what is new of what should not be."""
        now_s = time.monotonic()
        if now_s < self._watched_s + _WATCH_S:
            return
        self._watched_s = now_s
        warnings = [f"{missing}: not there any more" for missing in (arm.missing() for arm in self._arms) if missing]
        warnings += self._doubled()
        for warning in warnings:
            if warning not in self._warnings:
                self._say(warning)
        self._warnings = warnings


def bridge_arms(
    names: Sequence[str],
    topics: str,
    *,
    domain: int | None = None,
    ending: threading.Event | None = None,
    say: Say = say_on_stderr,
) -> None:
    """Serves the CRTK arms `names` to runs of ``trocar run --backend topics --topics NAME`` until `ending` is set.

    Then they come to rest as their stops have it. Raises `RosError` as `CrtkArms` does, and `trocar.TopicError`.
    """
    ending = ending or threading.Event()
    with contextlib.closing(CrtkArms(names, domain=domain, ending=ending, say=say)) as arms:
        if not arms.wait():
            return
        say(f"serving {', '.join(names)} on topics {topics!r}")
        serve_arms(arms, topics, count=len(names), ending=ending)
