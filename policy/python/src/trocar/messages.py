"""What travels on the topics: ctypes twins of the ``repr(C)`` types of ``hal`` and ``hal/topics``.

Each has the type name of its twin, in which the number after the last slash is the version: a topic whose type has another name, size
or alignment is refused when it is opened.
"""

from __future__ import annotations

import ctypes
from typing import ClassVar

ARM_NAMES = ("psm1", "psm2")
JOINT_COUNT = 6
STOP_PHASES = 3
CHUNK_STEPS_MAX = 128
CAMERAS_MAX = 8
LINE_BYTES_MAX = 248

# RunControl.code
WAIT, RUN, STOP = 0, 1, 2
# PolicyStatus.code
LOADING, READY = 0, 1
# PolicyReply.code
ANSWERED, OBSERVED, FAILED, ABANDONED = 0, 1, 2, 3


class Message(ctypes.Structure):
    """A message with its type name and the last part of its topic's."""

    NAME: ClassVar[str]
    TOPIC: ClassVar[str] = ""
    #: Unread messages that a reader keeps: with 1 the newest wins.
    UNREAD: ClassVar[int] = 1

    @classmethod
    def type_name(cls) -> str:
        """The name that the transport compares."""
        return cls.NAME


class Line(Message):
    """A line of text."""

    NAME = "trocar/line/1"
    _fields_ = [("length", ctypes.c_uint64), ("bytes", ctypes.c_uint8 * LINE_BYTES_MAX)]

    @classmethod
    def of(cls, text: str) -> Line:
        """As much of `text` as there is room for."""
        encoded = text.encode()[:LINE_BYTES_MAX].decode(errors="ignore").encode()
        line = cls()
        line.length = len(encoded)
        ctypes.memmove(line.bytes, encoded, len(encoded))
        return line

    @property
    def text(self) -> str:
        """The text; what is no text is marked."""
        return bytes(self.bytes)[: self.length].decode(errors="replace")


class TipTarget(Message):
    """Where the tip should be at one step."""

    NAME = "trocar/tip_target/1"
    _fields_ = [
        ("position_m", ctypes.c_double * 3),
        ("rotation_xyzw", ctypes.c_double * 4),
        ("jaw", ctypes.c_double),
    ]


class Chunk(Message):
    """A policy's answer to one observation, for one arm: ``targets[k]`` is due at ``observed_at + k * step_ns``."""

    NAME = "trocar/chunk/1"
    TOPIC = "chunk"
    _fields_ = [
        ("observed_at", ctypes.c_uint64),
        ("sequence", ctypes.c_uint64),
        ("step_ns", ctypes.c_uint64),
        ("len", ctypes.c_uint32),
        ("reserved", ctypes.c_uint32),
        ("targets", TipTarget * CHUNK_STEPS_MAX),
    ]


class ArmReport(Message):
    """The measured arm at a policy step, with its tip pose in the RCM frame."""

    NAME = "trocar/arm_report/2"
    TOPIC = "state"
    # A frame takes time: a reader finds the arms of its instant although they have been measured again since.
    UNREAD = 16
    _fields_ = [
        ("stamp", ctypes.c_uint64),
        ("sequence", ctypes.c_uint64),
        ("position", ctypes.c_double * JOINT_COUNT),
        ("velocity", ctypes.c_double * JOINT_COUNT),
        ("effort", ctypes.c_double * JOINT_COUNT),
        ("jaw_position", ctypes.c_double),
        ("jaw_velocity", ctypes.c_double),
        ("jaw_effort", ctypes.c_double),
        ("tip_position_m", ctypes.c_double * 3),
        ("tip_rotation_xyzw", ctypes.c_double * 4),
    ]


class ArmFeedback(Message):
    """What an arm in another process measured; on the topics of ``arms_of``, like its set-points."""

    NAME = "trocar/arm_feedback/1"
    TOPIC = "feedback"
    _fields_ = [
        ("stamp", ctypes.c_uint64),
        ("sequence", ctypes.c_uint64),
        ("position", ctypes.c_double * JOINT_COUNT),
        ("velocity", ctypes.c_double * JOINT_COUNT),
        ("effort", ctypes.c_double * JOINT_COUNT),
        ("jaw_position", ctypes.c_double),
        ("jaw_velocity", ctypes.c_double),
        ("jaw_effort", ctypes.c_double),
        # 0, or one more than the axis whose drive has failed, 7 for the jaw.
        ("fault", ctypes.c_uint64),
        ("fault_code", ctypes.c_uint64),
    ]


class AxisStop(Message):
    """One axis on its way to rest: a start, and phases of constant jerk; rad (m), s."""

    NAME = "trocar/axis_stop/1"
    _fields_ = [
        ("position", ctypes.c_double),
        ("velocity", ctypes.c_double),
        ("acceleration", ctypes.c_double),
        ("duration_s", ctypes.c_double * STOP_PHASES),
        ("jerk", ctypes.c_double * STOP_PHASES),
    ]


class ArmSetpoint(Message):
    """One set-point for an arm in another process, with the stop that follows if no other comes: the joints in order, then the jaw."""

    NAME = "trocar/arm_setpoint/1"
    TOPIC = "setpoint"
    # An arm that makes up for periods that it was late for finds the set-points of then.
    UNREAD = 64
    _fields_ = [
        ("stamp", ctypes.c_uint64),
        ("sequence", ctypes.c_uint64),
        ("position", ctypes.c_double * JOINT_COUNT),
        ("velocity", ctypes.c_double * JOINT_COUNT),
        ("acceleration", ctypes.c_double * JOINT_COUNT),
        ("jaw_position", ctypes.c_double),
        ("jaw_velocity", ctypes.c_double),
        ("enabled", ctypes.c_uint64),
        ("stop_stamp", ctypes.c_uint64),
        ("stop_enabled", ctypes.c_uint64),
        ("stop", AxisStop * (JOINT_COUNT + 1)),
    ]


class RunControl(Message):
    """What the session wants of the policy; another episode means: forget the past."""

    NAME = "trocar/run_control/1"
    TOPIC = "control"
    _fields_ = [
        ("stamp", ctypes.c_uint64),
        ("episode", ctypes.c_uint64),
        ("seed", ctypes.c_uint64),
        ("code", ctypes.c_uint64),
    ]


class PolicyStatus(Message):
    """A sign of life of the policy, with the episode that it has reset for."""

    NAME = "trocar/policy_status/1"
    TOPIC = "policy_status"
    _fields_ = [
        ("sequence", ctypes.c_uint64),
        ("episode", ctypes.c_uint64),
        ("queries", ctypes.c_uint64),
        ("infer_ns", ctypes.c_uint64),
        ("code", ctypes.c_uint64),
    ]


class PolicyHello(Message):
    """Who the policy is and what it wants to be shown."""

    NAME = "trocar/policy_hello/1"
    TOPIC = "policy_hello"
    _fields_ = [
        ("pid", ctypes.c_uint64),
        ("arm_count", ctypes.c_uint64),
        ("query_every_steps", ctypes.c_uint64),
        ("history_steps", ctypes.c_uint64),
        ("camera_count", ctypes.c_uint64),
        ("name", Line),
        ("cameras", Line * CAMERAS_MAX),
    ]


class SessionHello(Message):
    """What the session says of itself before its first episode."""

    NAME = "trocar/session_hello/2"
    TOPIC = "session_hello"
    _fields_ = [
        ("session", ctypes.c_uint64),
        ("pid", ctypes.c_uint64),
        ("arm_count", ctypes.c_uint64),
        ("lockstep", ctypes.c_uint64),
        ("step_ns", ctypes.c_uint64),
        ("frames_within_ns", ctypes.c_uint64),
        ("task", Line),
        ("instruction", Line),
    ]


class PolicyReply(Message):
    """The end of the policy's work on an observation."""

    NAME = "trocar/policy_reply/1"
    TOPIC = "policy_reply"
    _fields_ = [
        ("episode", ctypes.c_uint64),
        ("sequence", ctypes.c_uint64),
        ("chunk_count", ctypes.c_uint64),
        ("code", ctypes.c_uint64),
        ("text", Line),
    ]


class Distortion(Message):
    """What a lens does to straight lines: OpenCV's first four coefficients."""

    NAME = "trocar/distortion/1"
    _fields_ = [
        ("k1", ctypes.c_double),
        ("k2", ctypes.c_double),
        ("p1", ctypes.c_double),
        ("p2", ctypes.c_double),
    ]


class Intrinsics(Message):
    """A lens, pixels."""

    NAME = "trocar/intrinsics/2"
    _fields_ = [
        ("width", ctypes.c_uint32),
        ("height", ctypes.c_uint32),
        ("fx", ctypes.c_double),
        ("fy", ctypes.c_double),
        ("cx", ctypes.c_double),
        ("cy", ctypes.c_double),
        ("distortion", Distortion),
    ]


class FrameHeader(Message):
    """What describes a camera frame; its pixels follow as 32-bit words: depth, then colour, then instance ids."""

    NAME = "trocar/frame_header/2"
    _fields_ = [
        ("stamp", ctypes.c_uint64),
        ("sequence", ctypes.c_uint64),
        ("intrinsics", Intrinsics),
        ("position_m", ctypes.c_double * 3),
        ("rotation_xyzw", ctypes.c_double * 4),
    ]
