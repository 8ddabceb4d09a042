"""LeRobot's own classes on checkpoints: committed policies beside our engine, and policies of another rate. `make test-lerobot` has LeRobot."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trocar
from conftest import short
from trocar.policy import later, targets_of

pytest.importorskip("lerobot", reason="LeRobot is not installed: make test-lerobot installs it")

import torch
from lerobot.configs.default import DatasetConfig
from lerobot.configs.train import TrainPipelineConfig
from lerobot.configs.types import FeatureType, PolicyFeature
from lerobot.policies.act.configuration_act import ACTConfig
from lerobot.policies.act.modeling_act import ACTPolicy, ACTTemporalEnsembler
from lerobot.policies.factory import make_pre_post_processors
from trocar.lerobot import ServedPolicy, convert
from trocar.lerobot.model import load
from trocar.lerobot.network import TrocarACTPolicy, resampled

COMMITTED = Path(__file__).parents[3] / "config/policies"
PLAIN = ["--set", "scene.rendering.shading=plain"]
NEWEST = ["--set", "control.aggregation.mode=newest"]

#: Metres, components of a quaternion, radians: rounding of two implementations in single precision.
TOLERANCE = 5e-6
STEP_NS, STEP_15_NS = 40_000_000, 1_000_000_000 // 15


@pytest.fixture
def served(tmp_path: Path) -> Any:
    """Serves a folder by ``python -m trocar.lerobot serve`` for one session; none outlives the test."""
    begun: list[subprocess.Popen[str]] = []

    def start(folder: Path, name: str) -> subprocess.Popen[str]:
        command = [sys.executable, "-m", "trocar.lerobot", "serve", str(folder), "--name", name, "--sessions", "1"]
        begun.append(subprocess.Popen(command, env=os.environ | {"HF_HUB_OFFLINE": "1"}, stderr=subprocess.PIPE, text=True))
        return begun[-1]

    yield start
    for one in begun:
        one.kill()
        one.communicate()


class Beside:
    """Answers with the chunks that our engine's log has, and keeps how far from them a twin's are for the same observations."""

    def __init__(self, log: Path, topics: list[str], twin: ServedPolicy) -> None:
        tables = trocar.read_log(log, topics)
        self.chunks = [dict(zip(tables[topic]["observed_at_ns"], tables[topic]["targets"])) for topic in topics]
        self.twin = twin
        self.apart: list[float] = []

    def reset(self, seed: int) -> None:
        self.twin.reset(seed)

    def infer(self, observation: trocar.Observation) -> list[np.ndarray]:
        if observation.stamp_ns not in self.chunks[0]:
            # What was still on its way at the end is not in the log, and moves nothing.
            return [arm.here[None] for arm in observation.arms]
        ours = [np.array(chunks[observation.stamp_ns]) for chunks in self.chunks]
        for logged, answer in zip(ours, targets_of(self.twin.infer(observation), observation), strict=True):
            assert answer.shape == logged.shape
            # A quaternion and its negative are one rotation.
            side = np.sign((logged[:, 3:7] * answer[:, 3:7]).sum(axis=1, keepdims=True))
            answer[:, 3:7] *= side
            self.apart.append(float(np.abs(answer - logged).max()))
        return ours


@pytest.mark.parametrize(
    ("policy", "topics"),
    [
        ("needle-lift/act-compact", ["/policy/chunk"]),
        ("tissue-retraction/act-small", ["/policy/chunk"]),
        ("needle-handover/act-compact", ["/policy/chunk", "/policy/chunk/psm2"]),
    ],
    ids=["three stages", "four stages", "two arms"],
)
def test_a_twin_answers_each_observation_as_our_engine_does(
    policy: str, topics: list[str], name: str, session: Callable[..., Any], tmp_path: Path
) -> None:
    """At every query of an episode the twin is shown what our engine was shown, to the bit, since the engine's own chunks are played again."""
    task, log = policy.split("/")[0], tmp_path / "own.mcap"
    asked = ["run", "--task", task, "--lockstep", "--seed", "7", "--json", "-", *NEWEST, *PLAIN, *short(4.0)]
    _, out, err = session(*asked, "--policy", str(COMMITTED / policy), "--log", str(log)).end()
    own = json.loads(out)
    twin, every = load(COMMITTED / policy, STEP_NS)
    beside = Beside(log, topics, twin)
    running = session(*asked, "--policy", f"external:{name}")
    trocar.serve(beside, name, cameras=twin.cameras, query_every=every, history=twin.history, arms=twin.arms, sessions=1)
    _, out, err = running.end()
    assert json.loads(out)["command_hash"] == own["command_hash"], err
    assert len(beside.apart) == sum(map(len, beside.chunks)) >= 3 * len(topics)
    assert max(beside.apart) < TOLERANCE


def test_lerobot_eval_succeeds_where_trocar_eval_does(binary: str, session: Callable[..., Any], tmp_path: Path) -> None:
    """Executed an action a step without delay there, delayed by 160 ms and asked anew each second here: the episodes differ, their ends not."""
    policy, trials, seed = COMMITTED / "needle-lift/act-compact", 3, 1_000_000
    same = ["--task", "needle-lift", "--trials", str(trials), "--seed", str(seed), "--json", "-"]
    _, out, err = session("eval", "--policy", str(policy), *same).end()
    ours = [episode["success"] for episode in json.loads(out)["episodes"]]
    program = Path(sys.executable).parent / "lerobot-eval"
    command = [str(program), f"--policy.path={convert(policy, tmp_path / 'converted')}", "--env.type=trocar", "--env.task=needle-lift"]
    command += [f"--eval.n_episodes={trials}", "--eval.batch_size=1", f"--seed={seed}", f"--output_dir={tmp_path / 'eval'}"]
    environment = os.environ | {"TROCAR": binary, "HF_HUB_OFFLINE": "1"}
    done = subprocess.run(command, env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr[-3000:]
    (task,) = json.loads((tmp_path / "eval/eval_info.json").read_text())["per_task"]
    assert task["task_group"] == "needle-lift"
    assert task["metrics"]["successes"] == ours == [True] * trials, err


def test_a_policy_that_lerobot_trained_plays_at_its_datasets_rate(
    served: Callable[..., Any], name: str, binary: str, session: Callable[..., Any], tmp_path: Path
) -> None:
    """LeRobot's own ACT class, saved by LeRobot, of a dataset of 15 frames a second; random weights, actions about where the arm is."""
    env = trocar.make("needle-lift", binary=binary)
    seen, _ = env.reset(seed=7)
    env.close()
    inputs = {
        "observation.state": PolicyFeature(type=FeatureType.STATE, shape=(7,)),
        "observation.images.endoscope": PolicyFeature(type=FeatureType.VISUAL, shape=(3, 64, 64)),
    }
    sizes = {"dim_model": 64, "n_heads": 4, "dim_feedforward": 128, "n_encoder_layers": 1, "n_vae_encoder_layers": 1}
    config = ACTConfig(
        input_features=inputs,
        output_features={"action": PolicyFeature(type=FeatureType.ACTION, shape=(8,))},
        pretrained_backbone_weights=None,
        device="cpu",
        push_to_hub=False,
        chunk_size=60,
        n_action_steps=30,
        **sizes,
    )
    torch.manual_seed(5)
    statistics = {
        "observation.state": {"mean": torch.zeros(7), "std": torch.ones(7)},
        "observation.images.endoscope": {"mean": torch.full((3, 1, 1), 0.5), "std": torch.full((3, 1, 1), 0.25)},
        "action": {"mean": torch.tensor([*seen["tip"][0], seen["jaw"][0]]), "std": torch.full((8,), 1e-4)},
    }
    folder = tmp_path / "pretrained_model"
    for part in (ACTPolicy(config), *make_pre_post_processors(config, dataset_stats=statistics)):
        part.save_pretrained(folder)
    (tmp_path / "demos/meta").mkdir(parents=True)
    (tmp_path / "demos/meta/info.json").write_text('{"fps": 15}')
    TrainPipelineConfig(dataset=DatasetConfig("lab/lift", root=str(tmp_path / "demos")), policy=config).save_pretrained(folder)
    log = tmp_path / "run.mcap"
    server = served(folder, name)
    awaited = ["--policy", f"external:{name}", "--policy-timeout", "120", "--log", str(log), "--seed", "7", "--json", "-"]
    _, out, err = session("run", "--task", "needle-lift", "--lockstep", *awaited, *PLAIN, *NEWEST, *short(2.0)).end()
    assert json.loads(out)["policy"]["refused"] == 0, err
    _, said = server.communicate(timeout=60)
    assert "15 steps a second" in said
    chunks = trocar.read_log(log, ["/policy/chunk"])["/policy/chunk"]
    assert set(chunks["step_ns"]) == {STEP_15_NS} and set(chunks["len"]) == {60}
    # Half of the 30 that it would execute: 15 policy steps of 40 ms.
    assert set(np.diff(chunks["observed_at_ns"])) == {15 * STEP_NS} and len(chunks) >= 3


@pytest.fixture
def slow(tmp_path: Path) -> TrocarACTPolicy:
    """The committed policy of the handover, converted as if it had been trained at 15 frames a second."""
    folder = shutil.copytree(COMMITTED / "needle-handover/act-compact", tmp_path / "slow")
    recipe = json.loads((folder / "trocar.json").read_text())
    (folder / "trocar.json").write_text(json.dumps(recipe | {"step_ns": STEP_15_NS}))
    out = convert(folder, tmp_path / "converted")
    assert json.loads((out / "trocar.json").read_text())["step_ns"] == STEP_15_NS
    return TrocarACTPolicy.from_pretrained(out, strict=True)


def drawn(policy: TrocarACTPolicy, fps: int | None) -> dict[str, torch.Tensor]:
    """What a policy of two arms is shown by an environment of `fps` steps a second, which may not say so: noise, with tips that can be."""
    generator = torch.Generator().manual_seed(3)
    batch = {name: torch.randn(1, *feature.shape, generator=generator) for name, feature in policy.config.input_features.items()}
    tips = torch.randn(1, 2, 7, generator=generator)
    tips[..., 3:7] /= tips[..., 3:7].norm(dim=-1, keepdim=True)
    told = {} if fps is None else {"observation.step_ns": torch.tensor([1_000_000_000 // fps])}
    return batch | told | {"observation.tip_pose": tips.flatten(1)}


@pytest.mark.parametrize(("fps", "queue"), [(None, 25), (25, 25), (15, 15), (50, 50), (10, 10)])
def test_an_environment_gets_what_lies_at_the_ends_of_its_steps(fps: int | None, queue: int, slow: TrocarACTPolicy) -> None:
    """lerobot-eval asks for one action a step; a chunk of 15 steps a second is interpolated there, and asked for anew after a second."""
    step_ns = STEP_NS if fps is None else 1_000_000_000 // fps
    batch = drawn(slow, fps)
    chunk = slow.predict_action_chunk(batch)[0].numpy().astype(np.float64).reshape(-1, 2, 8)
    assert len(chunk) == slow.config.chunk_size and slow.config.n_action_steps == 25
    slow.reset()
    actions = [slow.select_action(batch)[0].numpy().reshape(2, 8) for _ in range(queue + 1)]
    for arm in range(2):
        rows = chunk[:, arm]
        rows[:, 3:7] /= np.linalg.norm(rows[:, 3:7], axis=1, keepdims=True)
        for step, action in enumerate(actions[:queue]):
            # The environment reaches it at the end of its step; a session has it then.
            np.testing.assert_allclose(action[arm], later(rows, (step + 1) * step_ns, STEP_15_NS)[0], atol=1e-5)
    # Then it is asked anew, and answers the same.
    np.testing.assert_allclose(actions[queue], actions[0], atol=1e-6)


def test_ensembled_chunks_want_an_environment_of_their_steps(slow: TrocarACTPolicy) -> None:
    slow.config.temporal_ensemble_coeff = 0.01
    with pytest.raises(ValueError, match="steps of 66666666 ns in an environment with steps of 40000000 ns"):
        slow.select_action({})


def test_ensembled_chunks_are_those_of_the_ends_of_steps(slow: TrocarACTPolicy) -> None:
    """The second step mixes the third row of the first chunk with the second row of the second, which is the same chunk."""
    slow.config.temporal_ensemble_coeff = decay = 0.5
    slow.temporal_ensembler = ACTTemporalEnsembler(decay, slow.config.chunk_size)
    batch = drawn(slow, 15)
    rows = slow.predict_action_chunk(batch)[0].unflatten(-1, (2, 8))
    rows[..., 3:7] /= rows[..., 3:7].norm(dim=-1, keepdim=True)
    rows = rows.flatten(-2).numpy()
    assert np.abs(np.diff(rows[:3], axis=0)).max(axis=1).min() > 1e-5
    slow.reset()
    found = [slow.select_action(batch)[0].numpy() for _ in range(2)]
    np.testing.assert_allclose(found[0], rows[1], atol=2e-6)
    newer = np.exp(-decay)
    np.testing.assert_allclose(found[1], (rows[2] + newer * rows[1]) / (1 + newer), atol=2e-6)


def test_resampled_chunks_end_with_their_last_row() -> None:
    generator = torch.Generator().manual_seed(4)
    rows = torch.randn(2, 4, 16, generator=generator, dtype=torch.float64).unflatten(-1, (2, 8))
    rows[..., 3:7] /= rows[..., 3:7].norm(dim=-1, keepdim=True)
    for from_ns, to_ns, steps in [(40, 40, 4), (20, 40, 2), (80, 40, 7), (100, 40, 8), (30, 40, 3), (10, 40, 1)]:
        found = resampled(rows.flatten(-2), 2, from_ns, to_ns).unflatten(-1, (2, 8))
        assert found.shape == (2, steps, 2, 8)
        for batch, arm, step in np.ndindex(2, 2, steps):
            expected = later(rows[batch, :, arm].numpy(), min((step + 1) * to_ns, 3 * from_ns), from_ns)[0]
            np.testing.assert_allclose(found[batch, step, arm].numpy(), expected, atol=1e-12)
