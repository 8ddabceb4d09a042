"""Environments of the tasks: Gymnasium's own checks, repeatability, ends."""

from __future__ import annotations

import functools
import json
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
import trocar
from conftest import PATIENT, short
from gymnasium.utils.env_checker import check_env
from trocar.policy import later

PLAIN = ["--set", "scene.rendering.shading=plain"]
STEP_NS = 40_000_000


@pytest.fixture
def make(binary: str) -> Iterator[Any]:
    """Makes environments and closes them."""
    made: list[trocar.TrocarEnv] = []

    def one(task: str = "needle-lift", seconds: float = 1.0, **kwargs: Any) -> trocar.TrocarEnv:
        options = [*short(seconds), *kwargs.pop("options", [])]
        made.append(trocar.make(task, binary=binary, options=options, **kwargs))
        return made[-1]

    yield one
    for env in made:
        env.close()


def episode(env: trocar.TrocarEnv, seed: int, actions: int = 7) -> tuple[np.ndarray, dict[str, Any]]:
    """The tips of an episode under random actions, and what is said at its end."""
    observation, _ = env.reset(seed=seed)
    random = np.random.default_rng(actions)
    tips = [observation["tip"]]
    while True:
        low, high = env.action_space.low, env.action_space.high
        observation, reward, terminated, truncated, info = env.step(random.uniform(low, high).astype(np.float32))
        tips.append(observation["tip"])
        assert reward == 0.0
        if terminated or truncated:
            assert truncated and not terminated
            return np.array(tips), info


@pytest.mark.parametrize("control", ["relative", "absolute"])
def test_gymnasiums_checker_finds_nothing(make: Any, control: str) -> None:
    check_env(make(control=control), skip_render_check=True)


def test_the_checker_finds_nothing_in_pictures(make: Any) -> None:
    env = make(cameras=["endoscope"], render_mode="rgb_array", image_size=(48, 64), options=PLAIN)
    check_env(env)
    observation, _ = env.reset(seed=3)
    picture = env.render()
    assert picture is not None and picture.shape == (48, 64, 3) and picture.std() > 5
    np.testing.assert_array_equal(picture, observation["endoscope"])


def test_lerobots_layout_has_the_numbers_of_a_dataset(make: Any) -> None:
    seen = dict(cameras=["endoscope"], image_size=(32, 32), options=PLAIN, control="absolute")
    env = make(layout="lerobot", **seen)
    check_env(env, skip_render_check=True)
    observation, _ = env.reset(seed=4)
    named, _ = make(**seen).reset(seed=4)
    state = [*named["joints"][0], named["jaw"][0]]
    np.testing.assert_array_equal(observation["agent_pos"], np.array(state, np.float32))
    np.testing.assert_array_equal(observation["pixels"]["endoscope"], named["endoscope"])
    with pytest.raises(ValueError, match="layout = 'flat'"):
        make(layout="flat")


def test_the_same_seed_and_actions_give_the_same_episode(make: Any) -> None:
    env = make()
    first, info = episode(env, 5)
    again, info_again = episode(env, 5)
    other, info_other = episode(env, 6)
    np.testing.assert_array_equal(first, again)
    assert info["command_hash"] == info_again["command_hash"]
    assert info["reason"] == info_again["reason"] and "within 1 s" in info["reason"]
    assert not info["success"] and info["seconds"] == pytest.approx(1.0, abs=0.05)
    assert len(first) == len(other) == 26
    elsewhere, _ = episode(make(), 5)
    np.testing.assert_array_equal(first, elsewhere)


def test_an_episode_can_be_left_and_begun_again(make: Any) -> None:
    env = make()
    whole, info = episode(env, 5)
    env.reset(seed=9)
    env.step(env.action_space.sample())
    again, info_again = episode(env, 5)
    np.testing.assert_array_equal(whole, again)
    assert info["command_hash"] == info_again["command_hash"]
    with pytest.raises(RuntimeError, match="call reset first"):
        env.step(env.action_space.sample())


def test_an_end_that_is_not_said_is_no_later_episodes(make: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    env = make()
    env.reset(seed=9)
    monkeypatch.setattr(env._child, "line", lambda timeout_s: None)
    with pytest.raises(RuntimeError, match="the end of the episode before was not said"):
        env.reset(seed=5)
    tips, _ = episode(env, 5)
    assert len(tips) == 26


def test_the_tip_goes_where_it_is_told(make: Any) -> None:
    env = make(control="absolute", seconds=3.0)
    observation, _ = env.reset(seed=1)
    goal = np.append(observation["tip"][0], 0.8).astype(np.float32)
    goal[:3] += [0.01, -0.01, 0.01]
    for _ in range(60):
        observation, *_ = env.step(goal)
    np.testing.assert_allclose(observation["tip"][0, :3], goal[:3], atol=5e-4)
    assert observation["jaw"][0] == pytest.approx(0.8, abs=0.02)


def test_two_arms_have_the_actions_of_both(make: Any) -> None:
    env = make("needle-handover")
    observation, _ = env.reset(seed=1)
    assert env.action_space.shape == (14,) and observation["tip"].shape == (2, 7)
    tips, info = episode(env, 2)
    assert len(info["command_hash"]) == 16 and np.ptp(tips[:, 1], axis=0).max() > 1e-4


def test_environments_run_beside_each_other(binary: str) -> None:
    one = functools.partial(trocar.make, "needle-lift", binary=binary, options=short())
    envs = gym.vector.AsyncVectorEnv([one, one])
    try:
        observations, _ = envs.reset(seed=[3, 4])
        assert observations["tip"].shape == (2, 1, 7)
        ended = np.zeros(2, bool)
        for _ in range(30):
            observations, rewards, terminated, truncated, _ = envs.step(np.zeros((2, 7), np.float32))
            ended |= truncated
        assert ended.all() and not rewards.any() and not terminated.any()
    finally:
        envs.close()


def test_gymnasium_makes_the_tasks_by_their_ids(binary: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TROCAR", binary)
    env = gym.make("trocar.env:trocar/needle-lift-v0", options=short())
    observation, info = env.reset(seed=11)
    assert observation["joints"].shape == (1, 6) and info["seed"] == 11
    env.close()


def test_a_session_that_cannot_begin_says_why(make: Any) -> None:
    env = make("needle-lift", options=["--needle", "N9"])
    with pytest.raises(RuntimeError, match="N9"):
        env.reset(seed=0)
    with pytest.raises(ValueError, match="how many arms"):
        make("a/folder")


def test_the_experts_targets_lift_the_needle_for_a_reward(
    make: Any, session: Callable[..., Any], tmp_path: Path
) -> None:
    log = tmp_path / "expert.mcap"
    expert = ["--policy", "expert", "--lockstep", "--seed", "7", "--log", str(log)]
    assert session("run", "--task", "needle-lift", *expert, *PLAIN).end()[0] == 0
    targets = [chunk[1] for chunk in trocar.read_log(log, ["/policy/chunk"])["/policy/chunk"]["targets"]]
    env = make(control="absolute", seconds=12.0)
    env.reset(seed=7)
    rewards = []
    for target in targets + [targets[-1]] * 50:
        _, reward, terminated, truncated, info = env.step(np.array(target))
        rewards.append(reward)
        if terminated or truncated:
            break
    assert terminated and not truncated and info["success"] and info["reason"] == "success"
    assert rewards[-1] == 1.0 and not any(rewards[:-1])


@pytest.mark.parametrize("fps", [10, 30, 50])
def test_steps_may_have_another_length(make: Any, fps: int) -> None:
    env, usual = make(step_ns=1_000_000_000 // fps), make()
    assert (env.metadata["render_fps"], usual.metadata["render_fps"], trocar.TrocarEnv.metadata["render_fps"]) == (fps, 25, 25)
    np.testing.assert_allclose(fps * env.action_space.high[:6], 25 * usual.action_space.high[:6], rtol=1e-6)
    assert env.action_space.high[6] == usual.action_space.high[6]
    tips, info = episode(env, 5)
    again, info_again = episode(env, 5)
    assert len(tips) == fps + 1 and info["seconds"] == pytest.approx(1.0, abs=0.05)
    np.testing.assert_array_equal(tips, again)
    assert info["command_hash"] == info_again["command_hash"]
    check_env(env, skip_render_check=True)


@pytest.mark.parametrize("step_ns", [0, 999_999, 1_000_000_001])
def test_a_step_of_no_possible_length_is_refused(step_ns: int, make: Any) -> None:
    with pytest.raises(ValueError, match=f"step_ns = {step_ns}: allowed are 1000000 to 1000000000"):
        make(step_ns=step_ns)


class Plays:
    """Answers with what lies at its own steps on a way through `targets`, which are `STEP_NS` apart."""

    def __init__(self, targets: np.ndarray, step_ns: int) -> None:
        self.targets, self.step_ns = targets, step_ns

    def at(self, stamp_ns: int) -> np.ndarray:
        rest = later(self.targets, min(stamp_ns, STEP_NS * (len(self.targets) - 2)), STEP_NS)
        return rest[0]

    def infer(self, observation: trocar.Observation) -> np.ndarray:
        return np.array([self.at(observation.stamp_ns + row * self.step_ns) for row in range(40)])


@pytest.mark.parametrize("fps", [10, 20, 30, 50])
def test_a_policy_of_another_rate_does_the_same_in_both(
    fps: int, make: Any, name: str, session: Callable[..., Any], tmp_path: Path
) -> None:
    """The expert's way at steps of another length lifts the needle in an environment of those steps, and served as that policy's chunks."""
    log, step_ns = tmp_path / "expert.mcap", 1_000_000_000 // fps
    expert = ["--policy", "expert", "--lockstep", "--seed", "7", "--log", str(log)]
    assert session("run", "--task", "needle-lift", *expert, *PLAIN).end()[0] == 0
    chunks = trocar.read_log(log, ["/policy/chunk"])["/policy/chunk"]["targets"]
    policy = Plays(np.array([chunks.iloc[0][0], *(chunk[1] for chunk in chunks)]), step_ns)
    env = make(control="absolute", seconds=12.0, step_ns=step_ns)
    env.reset(seed=7)
    ended, steps = False, 0
    while not ended:
        steps += 1
        _, reward, terminated, truncated, info = env.step(policy.at(steps * step_ns))
        ended = terminated or truncated
    assert info["success"] and reward == 1.0 and steps == pytest.approx(fps * info["seconds"], abs=1)
    asked = ["--policy", f"external:{name}", *PATIENT, "--trials", "1", "--seed", "7", "--latency-ms", "0"]
    running = session("eval", "--task", "needle-lift", *asked, "--json", "-")
    assert trocar.serve(policy, name, query_every=5, step_ns=step_ns, sessions=1) == 1
    _, out, err = running.end()
    (trial,) = json.loads(out)["episodes"]
    assert trial["success"], err


def test_an_environment_tells_what_is_to_be_done(make: Any) -> None:
    told = make(instruction="lift the needle by 20 mm")
    told.reset(seed=1)
    assert told.instruction == "lift the needle by 20 mm" == told._observation.instruction
    untold = make()
    untold.reset(seed=1)
    assert untold.instruction == "needle-lift" == untold._observation.instruction
