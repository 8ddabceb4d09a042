"""What a policy sees and what it may answer."""

from __future__ import annotations

import operator
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol, Union

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .messages import CHUNK_STEPS_MAX, ArmReport, Chunk, TipTarget

Array = NDArray[np.float64]

#: A quaternion whose length is this near to 1 stays as it is, to the bit: the gate takes far worse ones.
_UNIT_TOLERANCE = 1e-6

#: Time from one observation of a session to the next: a policy step, ns.
POLICY_STEP_NS = 40_000_000
#: Allowed times between two rows of an answer, ns: what the gate takes.
STEP_NS_MIN, STEP_NS_MAX = 1_000_000, 1_000_000_000

#: Numbers in an absolute action of one arm: x, y, z (m), quaternion x, y, z, w in the RCM frame, jaw (rad).
ABSOLUTE = 8
#: Numbers in a relative one: translation from the tip at the observation (m, axes of the RCM frame), rotation vector in the frame of that
#: tip (rad), jaw (rad, absolute).
RELATIVE = 7


class PolicyError(ValueError):
    """A policy's answer can't be used."""


@dataclass(frozen=True)
class Arm:
    """One measured arm."""

    #: Joint positions, rad (insertion m).
    joints: Array
    #: Joint velocities, rad/s (m/s).
    velocity: Array
    #: Joint efforts, N m (N).
    effort: Array
    #: Angle between the jaw fingers, rad; its rate, rad/s; and effort, N m.
    jaw: float
    jaw_velocity: float
    jaw_effort: float
    #: The tip in the RCM frame: x, y, z (m), quaternion x, y, z, w.
    tip: Array

    @property
    def here(self) -> Array:
        """Where the arm is, as an absolute action: the tip and the jaw."""
        return np.append(self.tip, self.jaw)


@dataclass(frozen=True)
class Frame:
    """One image, read-only, where the camera put it: valid during the call; copy what is to be kept."""

    #: sRGB, height x width x 3.
    colour: NDArray[np.uint8]
    #: Distance along the camera's z axis, m; 0 where nothing was hit. Height x width.
    depth_m: NDArray[np.float32]
    #: Instance ids, 0 is background. Height x width.
    instance: NDArray[np.uint8]
    #: fx, fy, cx, cy in pixels.
    intrinsics: tuple[float, float, float, float]
    #: The camera in the scene frame, x right, y down, z along the view: x, y, z (m), quaternion x, y, z, w.
    camera_in_scene: Array
    #: When it was taken, ns.
    stamp_ns: int
    #: k1, k2, p1, p2 (OpenCV), of all planes alike; zeros of a pinhole.
    distortion: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)


@dataclass(frozen=True)
class Observation:
    """What a policy sees at one instant."""

    #: When: in lockstep since the episode began, ns.
    stamp_ns: int
    #: The policy step of 40 ms.
    step: int
    #: The arms, in their order.
    arms: tuple[Arm, ...]
    #: The cameras that were asked for, by name.
    frames: Mapping[str, Frame]
    #: What is to be done, in words: what ``--instruction`` says, or else the task's name, as a dataset's ``task`` has it.
    instruction: str = ""
    #: What of the answer before is still to come, for policies whose chunks overlap (real-time chunking): of each arm the absolute targets
    #: (steps, 8), row k due k steps of the policy's after this observation; between two rows of that answer, what lies evenly between them.
    #: No rows at an episode's first query, or if none is left.
    left_over: tuple[Array, ...] = ()


#: One array an arm, of shape (steps, 8) or (steps, 7); of a single arm also the array itself.
Answer = Union[ArrayLike, Sequence[ArrayLike]]


class Policy(Protocol):
    """A policy. It may also have ``reset(seed)`` and, if it asks for a history, ``observe(observation)``."""

    def infer(self, observation: Observation) -> Answer:
        """Targets for each arm: row k is due k steps after the observation, of 40 ms each or of the ``step_ns`` that it is served with."""
        ...


def arm_of(report: ArmReport) -> Arm:
    """The arm in `report`."""
    return Arm(
        joints=np.array(report.position),
        velocity=np.array(report.velocity),
        effort=np.array(report.effort),
        jaw=report.jaw_position,
        jaw_velocity=report.jaw_velocity,
        jaw_effort=report.jaw_effort,
        tip=np.array([*report.tip_position_m, *report.tip_rotation_xyzw]),
    )


def multiply(a: Array, b: Array) -> Array:
    """The product of quaternions x, y, z, w, in the last axis."""
    av, aw, bv, bw = a[..., :3], a[..., 3:], b[..., :3], b[..., 3:]
    vector = aw * bv + bw * av + np.cross(av, bv)
    scalar = aw * bw - np.sum(av * bv, axis=-1, keepdims=True)
    return np.concatenate([vector, scalar], axis=-1)


def from_rotation_vector(vector: Array) -> Array:
    """The quaternions x, y, z, w of rotation vectors (rad), in the last axis."""
    half = 0.5 * np.linalg.norm(vector, axis=-1, keepdims=True)
    return np.concatenate([0.5 * np.sinc(half / np.pi) * vector, np.cos(half)], axis=-1)


def absolute(actions: Array, tip: Array) -> Array:
    """Absolute actions (steps, 8) of relative ones (steps, 7) for a tip at `tip`."""
    position = tip[:3] + actions[:, :3]
    rotation = multiply(np.broadcast_to(tip[3:7], (len(actions), 4)), from_rotation_vector(actions[:, 3:6]))
    return np.concatenate([position, rotation, actions[:, 6:]], axis=1)


def targets_of(answer: Any, observation: Observation) -> list[Array]:
    """The absolute targets, (steps, 8) for each arm, that `answer` means.

    Raises PolicyError, which names arm and step, for anything that is none.
    """
    count = len(observation.arms)
    if answer is None:
        raise PolicyError("the answer is None: one array an arm is wanted")
    if isinstance(answer, np.ndarray) and answer.ndim == 2:
        answer = [answer]
    try:
        given = list(answer)
    except TypeError as error:
        raise PolicyError(f"the answer is of type {type(answer).__name__}: one array an arm is wanted") from error
    if len(given) != count:
        raise PolicyError(f"the answer has arrays for {len(given)} arms, there are {count}: expected one per arm")
    return [_targets(index, array, arm) for index, (array, arm) in enumerate(zip(given, observation.arms))]


def _targets(index: int, given: Any, arm: Arm) -> Array:
    try:
        actions = np.asarray(given, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise PolicyError(f"arm {index}: the answer is no array of numbers: {error}") from error
    if actions.ndim != 2 or actions.shape[1] not in (ABSOLUTE, RELATIVE):
        raise PolicyError(
            f"arm {index}: the answer has shape {actions.shape}: allowed are (steps, {ABSOLUTE}), absolute, and (steps, {RELATIVE}), relative"
        )
    if not 1 <= len(actions) <= CHUNK_STEPS_MAX:
        raise PolicyError(f"arm {index}: the answer has {len(actions)} steps: allowed are 1 to {CHUNK_STEPS_MAX}")
    wrong = np.flatnonzero(~np.isfinite(actions).all(axis=1))
    if wrong.size:
        step = int(wrong[0])
        column = int(np.flatnonzero(~np.isfinite(actions[step]))[0])
        raise PolicyError(f"arm {index}, step {step}: number {column} of the answer is {actions[step, column]}")
    if actions.shape[1] == RELATIVE:
        actions = absolute(actions, arm.tip)
    length = np.linalg.norm(actions[:, 3:7], axis=1)
    short = np.flatnonzero(length < 1e-6)
    if short.size:
        raise PolicyError(f"arm {index}, step {int(short[0])}: the quaternion has no length")
    off = np.abs(length - 1.0) > _UNIT_TOLERANCE
    actions = actions.copy()
    actions[off, 3:7] /= length[off, None]
    return actions


def checked_step_ns(step_ns: int) -> int:
    """`step_ns`, the time between two rows of an answer, if there can be such rows.

    Raises ValueError if not, TypeError if it is no whole number.
    """
    step_ns = operator.index(step_ns)
    if not STEP_NS_MIN <= step_ns <= STEP_NS_MAX:
        raise ValueError(f"step_ns = {step_ns}: allowed are {STEP_NS_MIN} to {STEP_NS_MAX} (1 ms to 1 s)")
    return step_ns


def later(rows: Array, past_ns: int, step_ns: int) -> Array:
    """What of the absolute targets `rows` (steps, 8), which are `step_ns` apart, is still to come `past_ns` after the first: (fewer steps, 8).

    Where a row is due between two of `rows`, position and jaw are interpolated linearly, the rotation along the shortest arc.
    """
    past, rest_ns = divmod(past_ns, step_ns)
    if rest_ns == 0:
        return rows[past:]
    return _between(rows[past:-1], rows[past + 1 :], rest_ns / step_ns)


def _between(before: Array, after: Array, share: float) -> Array:
    mixed = (1.0 - share) * before + share * after
    cosine = np.sum(before[:, 3:7] * after[:, 3:7], axis=1, keepdims=True)
    angle = np.arccos(np.minimum(np.abs(cosine), 1.0))
    # sin(part * angle) / sin(angle), which is `part` of no angle; its sign that of the nearer of the two quaternions that are one rotation.
    first, second = (part * np.sinc(part * angle / np.pi) / np.sinc(angle / np.pi) for part in (1.0 - share, share))
    turned = first * before[:, 3:7] + np.copysign(second, cosine) * after[:, 3:7]
    mixed[:, 3:7] = turned / np.linalg.norm(turned, axis=1, keepdims=True)
    return mixed


def chunk_of(targets: Array, observed_at: int, sequence: int, step_ns: int) -> Chunk:
    """The chunk that carries `targets`."""
    chunk = Chunk(observed_at=observed_at, sequence=sequence, step_ns=step_ns, len=len(targets))
    raw = np.frombuffer(memoryview(chunk).cast("B"), dtype=np.float64, offset=Chunk.targets.offset)
    rows = raw.reshape(CHUNK_STEPS_MAX, ABSOLUTE)
    rows[:, 6] = 1.0
    rows[: len(targets)] = targets
    return chunk


assert TipTarget.jaw.offset == 7 * 8
