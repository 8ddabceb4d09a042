"""Serves arms: a robot or a simulator behind the controller of ``trocar run --backend topics``."""

from __future__ import annotations

import contextlib
import math
import os
import struct
import threading
import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from .messages import ARM_NAMES, JOINT_COUNT, ArmFeedback, ArmSetpoint
from .policy import Array
from .topics import Node

#: The topics' name unless another one is asked for, of the program and here.
DEFAULT_TOPICS = "drives"

# The messages as a tuple of numbers: ctypes takes ten times as long to give them one by one.
_SETPOINT = struct.Struct("=2Q20d3Q63d")
_FEEDBACK = struct.Struct("=2Q21d2Q")

#: A set-point that is older than this is of no controller that still lives, ns.
_AGE_NS_MAX = 100_000_000

#: How many times slower than the system's the clocks of controller and arms are, as in the program: for machines that are too slow.
_SLOW_MOTION = int(os.environ.get("TROCAR_SLOW_MOTION") or 1)

#: Numbers of one axis's stop: position, velocity, acceleration, three durations, three jerks.
_STOP_WORDS = 9


def now_ns() -> int:
    """The clock of set-points and feedback: the system's CLOCK_MONOTONIC, unless the environment slows it down."""
    return time.monotonic_ns() // _SLOW_MOTION


def arms_of(topics: str) -> str:
    """The run whose topics carry the arms of the run `topics`."""
    return f"{topics}-arms"


@dataclass(frozen=True)
class ArmState:
    """What an arm measured."""

    #: Joint positions, rad (insertion m).
    position: Array
    #: Joint velocities, rad/s (m/s).
    velocity: Array
    #: Joint efforts, N m (N).
    effort: Array
    #: Angle between the jaw fingers, rad, 0 is closed; its rate, rad/s; and effort, N m, negative closes.
    jaw_position: float
    jaw_velocity: float = 0.0
    jaw_effort: float = 0.0
    #: When it was measured, by ``now_ns``, which is CLOCK_MONOTONIC; if not given, when the period began.
    stamp_ns: int | None = None
    #: The axis whose drive has failed, 6 for the jaw, and the drive's own code, of 16 bits: the controller stops with them.
    fault: tuple[int, int] | None = None


@dataclass(frozen=True)
class ArmCommand:
    """One set-point for an arm: the controller's, or of the stop that follows when it sends no more."""

    #: The control period that it is for, by ``now_ns``, which is CLOCK_MONOTONIC.
    stamp_ns: int
    #: Joint positions, rad (insertion m).
    position: Array
    #: Joint velocities, rad/s (m/s).
    velocity: Array
    #: Joint accelerations, rad/s² (m/s²); information, drives need not use it.
    acceleration: Array
    #: Angle between the jaw fingers, rad; below contact the position error is the grip force. Its rate, rad/s.
    jaw_position: float
    jaw_velocity: float
    #: Whether the drives should hold torque at all. Without torque nothing else counts.
    enabled: bool

    @property
    def rests(self) -> bool:
        """Whether nothing moves: without torque, or with no velocity and no acceleration."""
        return not (self.enabled and (self.velocity.any() or self.acceleration.any() or self.jaw_velocity))


class Arms(Protocol):
    """A robot's arms, in the order of ``messages.ARM_NAMES``."""

    def exchange(self, commands: Sequence[ArmCommand] | None) -> Sequence[ArmState]:
        """Does what is commanded and measures each arm; called once a period, which it must not outlast.

        Before the first command `commands` is None: hold still, without torque.
        """
        ...


class StopPlayer:
    """What an arm is to do in each of its periods: the newest set-point, or else the next point of the stop that came with it.

    As ``hal::tail::TailPlayer`` plays it, to the bit. It reads no clock: a period without a new set-point is a period of the stop, and at
    the stop's end the arm rests.
    """

    def __init__(self, period_ns: int) -> None:
        self._period_ns = period_ns
        self._words: tuple[float, ...] | None = None
        self._stamp_ns = 0
        self._written = False

    def write(self, setpoint: ArmSetpoint) -> None:
        """Takes note of a set-point. One that has a number that is not finite, in its stop too, is none."""
        words = _SETPOINT.unpack_from(setpoint)
        if all(map(math.isfinite, words)):
            self._words = words
            self._stamp_ns = setpoint.stamp
            self._written = True

    def next_period(self) -> ArmCommand | None:
        """What to do in the period that begins; None before the first set-point."""
        if self._words is None:
            return None
        if self._written:
            self._written = False
            return _command(self._words)
        self._stamp_ns += self._period_ns
        return _stop_at(self._words, self._stamp_ns)


def stop_at(setpoint: ArmSetpoint, time_ns: int) -> ArmCommand:
    """The point at `time_ns` of the stop that came with `setpoint`; before it begins the first one, after its end at rest."""
    return _stop_at(_SETPOINT.unpack_from(setpoint), time_ns)


def _command(words: tuple[float, ...]) -> ArmCommand:
    return ArmCommand(
        stamp_ns=int(words[0]),
        position=np.array(words[2:8]),
        velocity=np.array(words[8:14]),
        acceleration=np.array(words[14:20]),
        jaw_position=words[20],
        jaw_velocity=words[21],
        enabled=words[22] != 0,
    )


def _stop_at(words: tuple[float, ...], time_ns: int) -> ArmCommand:
    begin_ns, enabled = int(words[23]), words[24] != 0
    time_s = max(time_ns - begin_ns, 0) * 1e-9
    axes = [_axis_at(words[first : first + _STOP_WORDS], time_s) for first in range(25, len(words), _STOP_WORDS)]
    position, velocity, acceleration = zip(*axes)
    return ArmCommand(
        stamp_ns=time_ns,
        position=np.array(position[:JOINT_COUNT]),
        velocity=np.array(velocity[:JOINT_COUNT]),
        acceleration=np.array(acceleration[:JOINT_COUNT]),
        jaw_position=position[JOINT_COUNT],
        jaw_velocity=velocity[JOINT_COUNT],
        enabled=enabled,
    )


def _axis_at(stop: tuple[float, ...], time_s: float) -> tuple[float, float, float]:
    """Position, velocity and acceleration after `time_s` of the stop of one axis."""
    p, v, a, *phases = stop
    begin_s = 0.0
    for duration_s, jerk in zip(phases[:3], phases[3:]):
        end_s = begin_s + max(duration_s, 0.0)
        under_way = time_s < end_s
        t = time_s - begin_s if under_way else max(duration_s, 0.0)
        # The order of hal/src/tail.rs: the same bits.
        p, v, a = p + t * (v + t * (a / 2.0 + t * jerk / 6.0)), v + t * (a + t * jerk / 2.0), a + t * jerk
        if under_way:
            return p, v, a
        begin_s = end_s
    return p, 0.0, 0.0


class _Port:
    """One arm's topics."""

    def __init__(self, node: Node, arm: str, period_ns: int) -> None:
        self._arm = arm
        self._setpoints = node.subscriber(ArmSetpoint, arm)
        self._feedback = node.publisher(ArmFeedback, arm)
        self._message = ArmFeedback()
        self._player = StopPlayer(period_ns)
        self._sequence = 0

    def next_period(self, *, stopping: bool) -> ArmCommand | None:
        """What the arm is to do; None if nobody has commanded it yet. If `stopping`, no set-point counts any more."""
        for setpoint in self._setpoints.unread():
            if not stopping and now_ns() - setpoint.stamp <= _AGE_NS_MAX:
                self._player.write(setpoint)
        return self._player.next_period()

    def limp(self, stamp_ns: int) -> ArmCommand:
        """The command of an arm that nobody commands yet, while others are commanded: where it was measured, without torque."""
        words = list(_FEEDBACK.unpack_from(self._message))
        blank = np.zeros(JOINT_COUNT)
        return ArmCommand(stamp_ns, np.array(words[2:8]), blank, blank, words[20], 0.0, enabled=False)

    def publish(self, state: ArmState, begun_ns: int) -> None:
        """Publishes what the arm measured in the period that began at `begun_ns`."""
        self._sequence += 1
        stamp_ns = begun_ns if state.stamp_ns is None else state.stamp_ns
        joints = [*self._joints(state.position), *self._joints(state.velocity), *self._joints(state.effort)]
        jaw = state.jaw_position, state.jaw_velocity, state.jaw_effort
        _FEEDBACK.pack_into(self._message, 0, stamp_ns, self._sequence, *joints, *jaw, *self._fault(state))
        self._feedback.publish(self._message)

    def _joints(self, given: Array) -> list[float]:
        array = np.asarray(given, dtype=np.float64)
        if array.shape != (JOINT_COUNT,):
            raise ValueError(f"{self._arm}: joints of shape {array.shape} were measured, expected ({JOINT_COUNT},)")
        numbers: list[float] = array.tolist()
        return numbers

    def _fault(self, state: ArmState) -> tuple[int, int]:
        if state.fault is None:
            return 0, 0
        axis, code = state.fault
        if not (0 <= axis <= JOINT_COUNT and 0 <= code <= 0xFFFF):
            raise ValueError(f"{self._arm}: fault of axis {axis}, code {code}: allowed are 0 to {JOINT_COUNT}, and 0 to 65535")
        return axis + 1, code


def serve_arms(
    arms: Arms,
    topics: str = DEFAULT_TOPICS,
    *,
    count: int = 1,
    period_s: float = 0.001,
    seconds: float | None = None,
    ending: threading.Event | None = None,
) -> int:
    """Serves `arms` to runs of ``trocar run --backend topics --topics NAME``, one after another.

    Every `period_s` seconds the first `count` arms get their set-points and are measured, whether a run is there or not; the first time
    they are only measured. In a period without a new set-point an arm gets the next point of the stop that came with the last one, to rest
    and for good, until another comes: it need not watch over the controller itself. Periods that were missed are left out.

    Ends after `seconds`, or with Ctrl-C; the number of periods. Nobody commands the arms from then on: hold them, or let them go. Once
    `ending` is set, by a signal handler for example, no set-point counts any more: each arm plays its stop, and serving ends when all
    rest. Raises what `arms` raise.
    """
    if not 1 <= count <= len(ARM_NAMES):
        raise ValueError(f"count = {count}: allowed are 1 to {len(ARM_NAMES)}")
    if not 1e-6 <= period_s < math.inf:
        raise ValueError(f"period_s = {period_s}: allowed is 1e-6 or more")
    period_ns = round(1e9 * period_s)
    node = Node(arms_of(topics))
    ports = [_Port(node, arm, period_ns) for arm in ARM_NAMES[:count]]
    periods = 0
    commands: list[ArmCommand] | None = None
    first_ns = deadline_ns = now_ns()
    # Ctrl-C may come at any place, in `arms` too.
    with contextlib.suppress(KeyboardInterrupt):
        while seconds is None or deadline_ns - first_ns < 1e9 * seconds:
            begun_ns = now_ns()
            states = arms.exchange(commands)
            if len(states) != count:
                raise ValueError(f"{len(states)} arms were measured, expected {count}")
            for port, state in zip(ports, states):
                port.publish(state, begun_ns)
            periods += 1
            stopping = ending is not None and ending.is_set()
            if stopping and all(command.rests for command in commands or ()):
                break
            deadline_ns = _wait(deadline_ns + period_ns, period_ns)
            commands = _commands(ports, stopping=stopping)
    return periods


def _commands(ports: Sequence[_Port], *, stopping: bool) -> list[ArmCommand] | None:
    given = [port.next_period(stopping=stopping) for port in ports]
    stamps = [command.stamp_ns for command in given if command is not None]
    if not stamps:
        return None
    return [port.limp(max(stamps)) if command is None else command for port, command in zip(ports, given)]


def _wait(deadline_ns: int, period_ns: int) -> int:
    """Waits for `deadline_ns`, or the last one that has passed if there are later ones; which one that was."""
    late_ns = now_ns() - deadline_ns
    if late_ns < 0:
        time.sleep(-late_ns * 1e-9 * _SLOW_MOTION)
        return deadline_ns
    return deadline_ns + late_ns // period_ns * period_ns
