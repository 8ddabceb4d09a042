"""Trocar's tasks for LeRobot's programs: ``--env.type=trocar --env.task=needle-lift``."""

from __future__ import annotations

import shlex
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import gymnasium as gym
import torch
from gymnasium.vector import AutoresetMode
from lerobot.configs.types import FeatureType, PolicyFeature
from lerobot.envs.configs import EnvConfig
from lerobot.envs.utils import freeze_after_episode_end, parse_camera_names
from lerobot.processor import ObservationProcessorStep, PolicyProcessorPipeline

from ..env import TASKS, TrocarEnv
from ..messages import JOINT_COUNT
from ..policy import ABSOLUTE, POLICY_STEP_NS
from .adapter import STATE, STEP_NS
from .checkpoint import FPS_MAX

#: Beyond every task's time limit, which ends an episode by itself, s.
_EPISODE_S_MAX = 60


@EnvConfig.register_subclass("trocar")
@dataclass
class TrocarEnvConfig(EnvConfig):
    """Tasks in lockstep, with absolute actions: what a dataset's ``action`` holds."""

    #: One task, or several with commas between them.
    task: str | None = "needle-lift"
    #: Steps a second, 1 to 1000: those of the dataset that the policy was trained on.
    fps: int = 1_000_000_000 // POLICY_STEP_NS
    #: Cameras that the policy sees, with commas between them.
    cameras: str = "endoscope"
    observation_height: int = 512
    observation_width: int = 512
    #: The program; TROCAR or the one on the path if not given.
    binary: str | None = None
    #: Further options of ``trocar environment``, as a shell has them: ``--set scene.rendering.shading=plain``.
    options: str = ""
    #: What is to be done, in words, for policies that read it; the task's name if not given.
    instruction: str | None = None
    render_mode: str = "rgb_array"
    #: Steps after which an episode is left; those of a minute if not given.
    episode_length: int | None = None
    features: dict[str, PolicyFeature] = field(default_factory=dict)
    features_map: dict[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """The features of the tasks, which must have the same number of arms."""
        if not 1 <= self.fps <= FPS_MAX:
            raise ValueError(f"--env.fps={self.fps}: allowed are 1 to {FPS_MAX}, whole steps a second")
        counts = {TASKS[task] for task in self.tasks}
        if len(counts) != 1:
            raise ValueError(f"--env.task={self.task}: the tasks differ in their number of arms")
        arms = counts.pop()
        self._add("action", FeatureType.ACTION, (ABSOLUTE * arms,), "action")
        self._add("agent_pos", FeatureType.STATE, ((JOINT_COUNT + 1) * arms,), "observation.state")
        self._add("tip_pose", FeatureType.STATE, (7 * arms,), "observation.tip_pose")
        for camera in parse_camera_names(self.cameras):
            shape = (self.observation_height, self.observation_width, 3)
            self._add(f"pixels/{camera}", FeatureType.VISUAL, shape, f"observation.images.{camera}")

    def _add(self, name: str, kind: Any, shape: tuple[int, ...], meant: str) -> None:
        self.features[name] = PolicyFeature(type=kind, shape=shape)
        self.features_map[name] = meant

    @property
    def tasks(self) -> list[str]:
        """The tasks by name."""
        names = [name.strip() for name in (self.task or "").split(",")]
        unknown = [name for name in names if name not in TASKS]
        if unknown:
            raise ValueError(f"--env.task={self.task}: allowed are {', '.join(TASKS)}, several with commas between them")
        return names

    @property
    def step_ns(self) -> int:
        """How long a step is, ns."""
        return 1_000_000_000 // self.fps

    @property
    def gym_kwargs(self) -> dict[str, Any]:
        """What an environment is made with."""
        cameras = parse_camera_names(self.cameras)
        return {
            "cameras": cameras,
            "render_camera": cameras[0],
            "render_mode": self.render_mode,
            "image_size": (self.observation_height, self.observation_width),
            "binary": self.binary,
            "options": shlex.split(self.options),
            "instruction": self.instruction,
            "episode_length": _EPISODE_S_MAX * self.fps if self.episode_length is None else self.episode_length,
            "step_ns": self.step_ns,
        }

    def get_env_processors(self) -> tuple[Any, Any]:
        """What is done to an observation and to an action: a policy is told how long a step is."""
        return PolicyProcessorPipeline(steps=[StepLength(self.step_ns)]), PolicyProcessorPipeline(steps=[])

    def create_envs(self, n_envs: int, use_async_envs: bool = False) -> dict[str, dict[int, Any]]:
        """A vector of environments for each task; one that has ended waits for the others."""
        kind: Any = gym.vector.SyncVectorEnv
        extra: dict[str, Any] = {"autoreset_mode": AutoresetMode.NEXT_STEP}
        if use_async_envs and n_envs > 1:
            kind = gym.vector.AsyncVectorEnv
            extra["context"] = "forkserver"
        made = {}
        for task in self.tasks:
            one = freeze_after_episode_end(partial(LerobotEnv, task, **self.gym_kwargs))
            made[task] = {0: kind([one] * n_envs, **extra)}
        return made


@dataclass
class StepLength(ObservationProcessorStep):
    """Adds to a batch of observations how long a step is, ns."""

    step_ns: int

    def observation(self, observation: dict[str, Any]) -> dict[str, Any]:
        """The observation with the length of a step, of shape (batch,)."""
        return observation | {STEP_NS: torch.full((len(observation[STATE]),), self.step_ns)}

    def transform_features(self, features: Any) -> Any:
        """The features as they are: it is no input of a network's."""
        return features


class LerobotEnv(TrocarEnv):
    """An environment with what LeRobot asks it for besides."""

    def __init__(self, task: str, *, episode_length: int, **kwargs: Any) -> None:
        super().__init__(task, control="absolute", layout="lerobot", **kwargs)
        self.task = task
        self._max_episode_steps = episode_length

    @property
    def task_description(self) -> str:
        """The task in words."""
        return self.instruction
