"""The plug-in `lerobot_env_trocar` as LeRobot finds it: its registry, its environments, its rollout. `make test-lerobot` has LeRobot."""

from __future__ import annotations

import importlib.metadata
import json
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import short

pytest.importorskip("lerobot", reason="LeRobot is not installed: make test-lerobot installs it")

import torch
from lerobot.envs.configs import EnvConfig
from lerobot.envs.factory import make_env, make_env_config, make_env_pre_post_processors
from lerobot.envs.utils import env_to_policy_features, preprocess_observation
from lerobot.processor import PolicyProcessorPipeline
from lerobot.scripts.lerobot_eval import rollout
from lerobot.utils.import_utils import register_third_party_plugins

PLAIN = ["--set", "scene.rendering.shading=plain"]


@pytest.fixture(scope="module", autouse=True)
def plug_in() -> None:
    """What each of LeRobot's programs does before it reads its command line."""
    register_third_party_plugins()


@pytest.fixture
def configured(binary: str) -> Callable[..., EnvConfig]:
    """The configuration that ``--env.type=trocar`` and further options make."""

    def make(task: str = "needle-lift", **kwargs: Any) -> EnvConfig:
        seen: dict[str, Any] = {"observation_height": 48, "observation_width": 64, "binary": binary, **kwargs}
        return make_env_config("trocar", task=task, options=" ".join([*PLAIN, *short()]), **seen)

    return make


@pytest.fixture
def made() -> Iterator[Callable[..., dict[str, Any]]]:
    """Makes environments as LeRobot does, and closes them."""
    begun: list[Any] = []

    def make(config: EnvConfig, **kwargs: Any) -> dict[str, Any]:
        suites = {suite: tasks[0] for suite, tasks in make_env(config, **kwargs).items()}
        begun.extend(suites.values())
        return suites

    yield make
    for one in begun:
        one.close()


class Rises(torch.nn.Module):
    """A policy of LeRobot's that has each tip 5 mm above where an episode begins, and the jaw as it is."""

    def __init__(self) -> None:
        super().__init__()
        self.told: list[list[str]] = []
        self.goal: torch.Tensor | None = None

    def reset(self) -> None:
        self.goal = None

    def select_action(self, batch: dict[str, Any]) -> torch.Tensor:
        self.told.append(batch["task"])
        tips, state = (batch[f"observation.{name}"].unflatten(-1, (-1, 7)) for name in ("tip_pose", "state"))
        if self.goal is None:
            self.goal = tips + 0.005 * torch.eye(7)[2]
        return torch.cat([self.goal, state[..., 6:]], dim=-1).flatten(-2)


def rolled_out(env: Any, config: EnvConfig, policy: torch.nn.Module, seeds: list[int]) -> dict[str, Any]:
    """An episode in each environment by LeRobot's own rollout, with the observations that a policy is shown."""
    before, after = make_env_pre_post_processors(config, None)
    same: list[Any] = [PolicyProcessorPipeline(steps=[], to_transition=dict, to_output=dict), lambda action: action]
    return rollout(env, policy, before, after, *same, seeds=seeds, return_observations=True)


def test_lerobots_discovery_imports_the_plug_in() -> None:
    assert importlib.metadata.version("lerobot_env_trocar")
    assert "lerobot_env_trocar" in sys.modules
    assert EnvConfig.get_choice_class("trocar").__module__ == "trocar.lerobot.environment"


@pytest.mark.parametrize(("task", "arms"), [("needle-lift", 1), ("needle-handover", 2)])
def test_what_a_policy_is_shown_has_the_features_of_a_dataset(
    task: str,
    arms: int,
    configured: Callable[..., EnvConfig],
    made: Callable[..., dict[str, Any]],
    session: Callable[..., Any],
    tmp_path: Path,
) -> None:
    config = configured(task, cameras="endoscope,side")
    (env,) = made(config, n_envs=2).values()
    observation, info = env.reset(seed=[3, 4])
    assert env.observation_space.contains(observation) and list(info["seed"]) == [3, 4]
    shown = preprocess_observation(observation)
    assert {name: tuple(value.shape) for name, value in shown.items()} == {
        "observation.state": (2, 7 * arms),
        "observation.tip_pose": (2, 7 * arms),
        "observation.images.endoscope": (2, 3, 48, 64),
        "observation.images.side": (2, 3, 48, 64),
    }
    assert {value.dtype for value in shown.values()} == {torch.float32}
    for camera in ("endoscope", "side"):
        image = shown[f"observation.images.{camera}"]
        assert 0 <= image.min() and image.max() <= 1 and image.std() > 0.02
    # The seeds are two episodes.
    assert not torch.equal(shown["observation.images.endoscope"][0], shown["observation.images.endoscope"][1])
    features = env_to_policy_features(config)
    named = {name: feature.shape for name, feature in features.items() if name != "action"}
    assert named == {name: value.shape[1:] for name, value in shown.items()}
    assert features["action"].shape == env.single_action_space.shape == (8 * arms,)
    # What `trocar record` writes of the same task is what a policy is trained on.
    recorded = ["record", "--task", task, "--source", "expert", "--episodes", "1", "--out", str(tmp_path / "demos")]
    code, _, err = session(*recorded, *PLAIN).end()
    assert code == 0, err
    found = json.loads((tmp_path / "demos/meta/info.json").read_text())
    assert found["fps"] == config.fps == env.unwrapped.metadata["render_fps"]
    for name in ("action", "observation.state", "observation.tip_pose"):
        assert tuple(found["features"][name]["shape"]) == features[name].shape


def test_lerobots_rollout_runs_an_episode(configured: Callable[..., EnvConfig], made: Callable[..., dict[str, Any]]) -> None:
    config = configured(instruction="lift it")
    (env,) = made(config, n_envs=2).values()
    policy = Rises()
    told = rolled_out(env, config, policy, seeds=[7, 8])
    # A second of steps of 40 ms, at the end of which the time limit ends both.
    assert told["action"].shape == (2, 25, 8)
    assert told["done"][:, -1].all() and not told["done"][:, :-1].any() and not told["success"].any()
    assert policy.told == [["lift it", "lift it"]] * 25
    seen = told["observation"]
    assert seen["observation.images.endoscope"].shape == (2, 26, 3, 48, 64)
    height = seen["observation.tip_pose"][..., 2]
    risen = height[:, -1] - height[:, 0]
    assert ((risen - 0.005).abs() < 5e-4).all(), risen
    again = rolled_out(env, config, policy, seeds=[7, 8])
    assert torch.equal(again["observation"]["observation.tip_pose"], seen["observation.tip_pose"])


@pytest.mark.parametrize("fps", [10, 30, 50])
def test_an_environment_has_the_rate_of_the_policy(fps: int, configured: Callable[..., EnvConfig], made: Callable[..., dict[str, Any]]) -> None:
    config = configured(fps=fps)
    (env,) = made(config, n_envs=1).values()
    assert env.unwrapped.metadata["render_fps"] == fps and env.call("_max_episode_steps") == (60 * fps,)
    assert rolled_out(env, config, Rises(), seeds=[7])["done"].shape == (1, fps)
    told, _ = make_env_pre_post_processors(config, None)
    shown = told({"observation.state": torch.zeros(2, 7), "task": ["lift", "lift"]})
    assert shown["observation.step_ns"].tolist() == [1_000_000_000 // fps] * 2


def test_environments_run_in_processes_of_their_own(configured: Callable[..., EnvConfig], made: Callable[..., dict[str, Any]]) -> None:
    """LeRobot's default: forkserver processes, which import the plug-in's environments by themselves."""
    config = configured()
    beside = rolled_out(made(config, n_envs=2, use_async_envs=True)["needle-lift"], config, Rises(), seeds=[7, 8])
    here = rolled_out(made(config, n_envs=2)["needle-lift"], config, Rises(), seeds=[7, 8])
    assert here["done"].shape == (2, 25)
    for name, value in here["observation"].items():
        assert torch.equal(beside["observation"][name], value), name


def test_several_tasks_are_environments_of_their_own(configured: Callable[..., EnvConfig], made: Callable[..., dict[str, Any]]) -> None:
    config = configured("needle-lift, tissue-retraction")
    envs = made(config)
    assert list(envs) == ["needle-lift", "tissue-retraction"]
    for task, env in envs.items():
        policy = Rises()
        assert rolled_out(env, config, policy, seeds=[5])["done"].shape == (1, 25)
        assert policy.told == [[task]] * 25


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"fps": 0}, r"--env\.fps=0: allowed are 1 to 1000, whole steps a second"),
        ({"fps": 1001}, r"--env\.fps=1001: allowed are 1 to 1000, whole steps a second"),
        ({"task": "needle-lift,needle-handover"}, "differ in their number of arms"),
        ({"task": "knot-tying"}, r"--env\.task=knot-tying: allowed are needle-lift"),
    ],
    ids=["no steps", "too many steps", "arms", "task"],
)
def test_what_no_environment_has_is_refused(options: dict[str, Any], said: str, configured: Callable[..., EnvConfig]) -> None:
    with pytest.raises(ValueError, match=said):
        configured(**options)
