"""A model that takes LeRobot's observations and answers with a chunk, as a policy of Trocar. Without LeRobot itself."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..messages import CHUNK_STEPS_MAX, JOINT_COUNT
from ..policy import ABSOLUTE, POLICY_STEP_NS, RELATIVE, Array, Arm, Observation, PolicyError

Floats = NDArray[np.float32]

STATE = "observation.state"
TIP_POSE = "observation.tip_pose"
IMAGES = "observation.images."
#: How long a step of the environment is that shows it, ns: of LeRobot's programs, whose policies answer with an action a step.
STEP_NS = "observation.step_ns"

#: Takes a batch of one, (1, ...) or with a history (1, steps, ...), and the instruction; answers with (steps, numbers).
Model = Callable[[Mapping[str, Floats], str], Floats]


@dataclass(frozen=True)
class Features:
    """What a model is shown and answers."""

    #: Height and width of its images, by camera.
    images: Mapping[str, tuple[int, int]]
    #: Numbers of state: joints and jaw of each arm.
    state: int
    #: Numbers of action: absolute poses or relative ones, and jaws, of each arm.
    action: int
    #: Observations that it is shown at once.
    steps: int = 1

    @property
    def arms(self) -> int:
        """How many arms the state is of.

        Raises PolicyError if it is of none, or the action is not theirs.
        """
        arms, rest = divmod(self.state, JOINT_COUNT + 1)
        if rest or arms not in (1, 2) or self.action not in (ABSOLUTE * arms, RELATIVE * arms):
            raise PolicyError(
                f"{self.state} numbers of state and {self.action} of action are not those of one or two arms: "
                f"a state has {JOINT_COUNT + 1} an arm, an action {ABSOLUTE} (absolute) or {RELATIVE} (relative)"
            )
        return arms


class ServedPolicy:
    """Serves `model`, whose rows and whose observations are `step_ns` apart; ``reset(seed)`` forgets what it was shown and calls `seeded`.

    A session's observations are 40 ms apart; of those the model is shown the nearest to each instant of its own.

    Raises PolicyError if the features are no robot's, or an instant of the history is further than half a step from the nearest observation.
    """

    def __init__(
        self,
        model: Model,
        features: Features,
        seeded: Callable[[int], None] | None = None,
        step_ns: int = POLICY_STEP_NS,
    ) -> None:
        self.features = features
        self.arms = features.arms
        self.cameras = list(features.images)
        self.step_ns = step_ns
        self.history = _history(features.steps, step_ns)
        self._model = model
        self._seeded = seeded
        self._seen: deque[tuple[int, dict[str, Floats]]] = deque(maxlen=self.history + 1)

    def reset(self, seed: int) -> None:
        """An episode begins."""
        self._seen.clear()
        if self._seeded is not None:
            self._seeded(seed)

    def observe(self, observation: Observation) -> None:
        """Remembers what precedes a query."""
        self._seen.append((observation.stamp_ns, self.inputs(observation)))

    def infer(self, observation: Observation) -> list[Array]:
        """The chunk of each arm."""
        self.observe(observation)
        # Oldest first; an episode's first observation stands for those before it.
        seen = [self._nearest(observation.stamp_ns - back * self.step_ns) for back in reversed(range(self.features.steps))]
        if self.features.steps == 1:
            batch = {name: value[None] for name, value in seen[0].items()}
        else:
            batch = {name: np.stack([one[name] for one in seen])[None] for name in seen[0]}
        rows = np.asarray(self._model(batch, observation.instruction), dtype=np.float64)
        if rows.ndim != 2 or rows.shape[1] != self.features.action:
            raise PolicyError(f"the model answers with shape {rows.shape}: (steps, {self.features.action}) is wanted")
        return list(np.split(rows[:CHUNK_STEPS_MAX], self.arms, axis=1))

    def _nearest(self, stamp_ns: int) -> dict[str, Floats]:
        return min(self._seen, key=lambda seen: abs(seen[0] - stamp_ns))[1]

    def inputs(self, observation: Observation) -> dict[str, Floats]:
        """What the model is shown of `observation`: channels first, 0 to 1."""
        shown = {
            STATE: joined(observation.arms, lambda arm: np.append(arm.joints, arm.jaw)),
            TIP_POSE: joined(observation.arms, lambda arm: arm.tip),
        }
        for camera, size in self.features.images.items():
            image = area_average(observation.frames[camera].colour, size)
            shown[IMAGES + camera] = np.ascontiguousarray(image.transpose(2, 0, 1), dtype=np.float32) / np.float32(255)
        return shown


def _history(steps: int, step_ns: int) -> int:
    """The policy steps before a query that reach back to the first of `steps` observations, `step_ns` apart."""
    nearest = [(2 * back * step_ns + POLICY_STEP_NS) // (2 * POLICY_STEP_NS) for back in range(steps)]
    if any(2 * abs(found * POLICY_STEP_NS - back * step_ns) > step_ns for back, found in enumerate(nearest)):
        raise PolicyError(
            f"it is shown {steps} observations at once, {step_ns / 1e6:g} ms apart: those of a session are {POLICY_STEP_NS // 1_000_000} ms "
            "apart, too far for that"
        )
    return nearest[-1]


def joined(arms: tuple[Arm, ...], numbers: Callable[[Arm], Array]) -> Floats:
    """The numbers of all arms, one after another."""
    return np.concatenate([numbers(arm) for arm in arms]).astype(np.float32)


def area_average(image: NDArray[np.uint8], size: tuple[int, int]) -> NDArray[np.uint8]:
    """`image` (height, width, 3) at `size` (height, width), which it is a whole multiple of: blocks averaged, rounded to nearest.

    Raises PolicyError for another size.
    """
    height, width = size
    factor = image.shape[0] // height
    if factor < 1 or image.shape[:2] != (factor * height, factor * width):
        raise PolicyError(f"an image of {image.shape[1]}x{image.shape[0]} is no whole multiple of {width}x{height}")
    if factor == 1:
        return image
    sums = image.reshape(height, factor, width, factor, 3).sum(axis=(1, 3), dtype=np.uint32)
    area = factor * factor
    shrunk: NDArray[np.uint8] = ((sums + area // 2) // area).astype(np.uint8)
    return shrunk
