"""LeRobot's side without LeRobot: what a model is shown and answers, and converted checkpoints. With it: tests/scripts/lerobot_*.py."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trocar
from conftest import short
from safetensors.numpy import load_file
from trocar.lerobot import CheckpointError, Features, ServedPolicy, convert
from trocar.lerobot.__main__ import main
from trocar.lerobot.adapter import area_average
from trocar.lerobot.checkpoint import policy_steps, step_ns_of, wants_conversion

COMMITTED = Path(__file__).parents[3] / "config/policies"


class Holds:
    """Answers with where the arms are in what it is shown, or above that, and keeps what it is shown."""

    def __init__(self, above_m: float = 0.0) -> None:
        self.above_m = above_m
        self.shown: list[Mapping[str, np.ndarray]] = []
        self.told: list[str] = []
        self.seeds: list[int] = []

    def __call__(self, batch: Mapping[str, np.ndarray], instruction: str) -> np.ndarray:
        self.shown.append(batch)
        self.told.append(instruction)
        newest = {name: value.reshape(-1, value.shape[-1])[-1] for name, value in batch.items() if "images" not in name}
        state, tip = newest["observation.state"].reshape(-1, 7), newest["observation.tip_pose"].reshape(-1, 7)
        return np.repeat(np.column_stack([tip + np.eye(7)[2] * self.above_m, state[:, 6]]).reshape(1, -1), 30, axis=0)


def observation(step: int = 0, arms: int = 1) -> trocar.Observation:
    random = np.random.default_rng(step)
    seen = []
    for _ in range(arms):
        joints, velocity, effort = random.normal(size=(3, 6))
        tip = np.append(random.normal(size=3), [0, 0, 0, 1.0])
        seen.append(trocar.Arm(joints, velocity, effort, random.normal(), 0.0, 0.0, tip))
    colour = random.integers(0, 256, (64, 96, 3), dtype=np.uint8)
    frame = trocar.Frame(colour, np.zeros((64, 96), np.float32), colour[..., 0], (1, 1, 0, 0), np.zeros(7), 0)
    return trocar.Observation(stamp_ns=40_000_000 * step, step=step, arms=tuple(seen), frames={"endoscope": frame})


def test_a_model_is_shown_the_numbers_of_a_dataset() -> None:
    model = Holds()
    policy = ServedPolicy(model, Features({"endoscope": (32, 48)}, state=14, action=16))
    assert (policy.arms, policy.cameras, policy.history) == (2, ["endoscope"], 0)
    seen = observation(arms=2)
    answer = policy.infer(seen)
    shown = model.shown[0]
    assert {name: value.shape for name, value in shown.items()} == {
        "observation.state": (1, 14),
        "observation.tip_pose": (1, 14),
        "observation.images.endoscope": (1, 3, 32, 48),
    }
    for index, arm in enumerate(seen.arms):
        np.testing.assert_array_equal(shown["observation.state"][0, 7 * index : 7 * index + 6], arm.joints.astype(np.float32))
        np.testing.assert_allclose(answer[index], np.repeat(arm.here[None], 30, axis=0), atol=1e-6)
    image = np.rint(shown["observation.images.endoscope"][0] * 255).transpose(1, 2, 0)
    np.testing.assert_array_equal(image, area_average(seen.frames["endoscope"].colour, (32, 48)))


def test_a_history_is_shown_oldest_first_and_forgotten_at_a_reset() -> None:
    model = Holds()
    policy = ServedPolicy(model, Features({}, state=7, action=8, steps=3), model.seeds.append)
    assert policy.history == 2
    for step in (1, 2):
        policy.observe(observation(step))
    policy.infer(observation(3))
    state = model.shown[0]["observation.state"]
    assert state.shape == (1, 3, 7)
    for row, step in enumerate((1, 2, 3)):
        np.testing.assert_array_equal(state[0, row, :6], observation(step).arms[0].joints.astype(np.float32))
    policy.reset(5)
    policy.infer(observation(9))
    begun = model.shown[1]["observation.state"][0]
    assert model.seeds == [5]
    np.testing.assert_array_equal(begun[0], begun[2])


@pytest.mark.parametrize(
    ("fps", "steps", "shown"),
    [(25, 3, [10, 11, 12]), (15, 3, [9, 10, 12]), (10, 3, [7, 9, 12]), (10, 2, [9, 12]), (5, 2, [7, 12]), (30, 3, [10, 11, 12])],
)
def test_a_history_is_of_the_models_own_rate(fps: int, steps: int, shown: list[int]) -> None:
    """The nearest of a session's observations, which are 40 ms apart: at 15 frames a second those of 133 and 67 ms before."""
    model = Holds()
    policy = ServedPolicy(model, Features({}, 7, 8, steps), step_ns=1_000_000_000 // fps)
    assert policy.history == 12 - shown[0]
    # As many as are asked for before a query, with another query's among them.
    for step in range(2, 12):
        (policy.infer if step == 8 else policy.observe)(observation(step))
    policy.infer(observation(12))
    found = model.shown[-1]["observation.state"][0, :, :6]
    np.testing.assert_array_equal(found, [observation(step).arms[0].joints.astype(np.float32) for step in shown])


def test_a_history_finer_than_what_is_shown_is_refused() -> None:
    with pytest.raises(trocar.PolicyError, match="2 observations at once, 20 ms apart: those of a session are 40 ms apart"):
        ServedPolicy(Holds(), Features({}, 7, 8, steps=2), step_ns=20_000_000)
    assert ServedPolicy(Holds(), Features({}, 7, 8), step_ns=20_000_000).history == 0


def test_blocks_are_averaged_and_rounded_as_our_engine_does() -> None:
    rows = [[[0, 8, 255], [1, 8, 0], [2, 8, 0], [3, 8, 0]], [[4, 8, 0], [5, 8, 0], [6, 8, 0], [7, 8, 0]]]
    assert area_average(np.array(rows, dtype=np.uint8), (1, 2)).tolist() == [[[3, 8, 64], [5, 8, 0]]]
    for size in [(2, 3), (1, 4), (4, 8)]:
        with pytest.raises(trocar.PolicyError, match="no whole multiple"):
            area_average(np.zeros((2, 4, 3), np.uint8), size)


@pytest.mark.parametrize("features", [(7, 9), (6, 8), (21, 24), (14, 8)], ids=str)
def test_features_of_another_robot_are_refused(features: tuple[int, int]) -> None:
    with pytest.raises(trocar.PolicyError, match="are not those of one or two arms"):
        ServedPolicy(Holds(), Features({}, *features))


def test_a_model_of_another_shape_is_named() -> None:
    policy = ServedPolicy(lambda batch, instruction: np.zeros((3, 7), np.float32), Features({}, 7, 8))
    with pytest.raises(trocar.PolicyError, match=r"answers with shape \(3, 7\): \(steps, 8\) is wanted"):
        policy.infer(observation())


def test_a_served_model_takes_part_in_a_session(name: str, session: Callable[..., Any]) -> None:
    model = Holds(above_m=0.002)
    policy = ServedPolicy(model, Features({"endoscope": (64, 64)}, 7, 8, steps=2), model.seeds.append)
    wanted = ["--policy", f"external:{name}", "--trials", "1", "--instruction", "lift it", "--set", "scene.rendering.shading=plain", *short()]
    running = session("eval", "--task", "needle-lift", *wanted)
    assert trocar.serve(policy, name, cameras=policy.cameras, query_every=10, history=policy.history, arms=policy.arms, sessions=1) == 1
    code, _, err = running.end()
    assert code == 0, err
    assert len(model.shown) == 3 and model.seeds == [1_000_000] and model.told == ["lift it"] * 3
    first, second = (model.shown[index]["observation.images.endoscope"] for index in (0, 1))
    assert first.shape == (1, 2, 3, 64, 64) and first.std() > 0.01
    np.testing.assert_array_equal(first[0, 0], first[0, 1])
    assert not np.array_equal(second[0, 1], first[0, 1])


@pytest.mark.parametrize(
    ("committed", "arms", "stages"),
    [("tissue-retraction/act-small", 1, 4), ("needle-handover/act-compact", 2, 3)],
    ids=["one arm", "two arms"],
)
def test_committed_policies_convert(committed: str, arms: int, stages: int, tmp_path: Path) -> None:
    out = convert(COMMITTED / committed, tmp_path / "out")
    config = json.loads((out / "config.json").read_text())
    assert (config["type"], config["vision_backbone"], config["use_vae"]) == ("trocar_act", "resnet18", False)
    assert (config["backbone_norm"], config["backbone_stages"], config["relative"]) == ("group_norm", stages, True)
    assert config["output_features"]["action"]["shape"] == [8 * arms] and config["n_action_steps"] == 25
    tensors = load_file(out / "model.safetensors")
    assert {tensor.dtype for tensor in tensors.values()} == {np.dtype(np.float32)}
    assert tensors["action_std"].shape == (7 * arms,) and not any("vae" in name for name in tensors)
    assert config["step_ns"] == 40_000_000
    steps = [step["registry_name"] for step in json.loads((out / "policy_preprocessor.json").read_text())["steps"]]
    assert steps.index("trocar_area_average") == steps.index("normalizer_processor") - 1
    with pytest.raises(CheckpointError, match="is there already"):
        convert(COMMITTED / committed, out)


@pytest.mark.parametrize(
    ("backbone", "norm", "converted"),
    [
        ("resnet18", "frozen_batch_norm", False),
        ("resnet18", "group_norm", True),
        ("group_norm_resnet18", "group_norm", True),
        ("resnet18_stages3", "frozen_batch_norm", True),
    ],
)
def test_only_what_lerobots_class_lacks_is_converted(backbone: str, norm: str, converted: bool, tmp_path: Path) -> None:
    (tmp_path / "config.json").write_text(json.dumps({"type": "act", "vision_backbone": backbone}))
    assert not wants_conversion(tmp_path)
    recipe = {"action_representation": "observation_relative", "variants": {"backbone_norm": norm}}
    (tmp_path / "trocar.json").write_text(json.dumps(recipe))
    assert wants_conversion(tmp_path) == converted


def test_what_is_no_checkpoint_of_acts_is_bad_input(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["convert", str(tmp_path), str(tmp_path / "out")]) == 2
    assert "config.json: No such file" in capsys.readouterr().err
    (tmp_path / "config.json").write_text('{"type": "dp3"}')
    with pytest.raises(CheckpointError, match=r"trocar\.json: missing"):
        convert(tmp_path, tmp_path / "out")
    (tmp_path / "trocar.json").write_text("{}")
    with pytest.raises(CheckpointError, match="type = 'dp3': allowed is 'act'"):
        convert(tmp_path, tmp_path / "out")


def test_policies_that_queue_observations_are_refused_by_type(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "config.json").write_text('{"type": "vqbet"}')
    assert main(["serve", str(tmp_path)]) == 2
    said = capsys.readouterr().err
    assert "config.json: type = 'vqbet' can't be served" in said and "lerobot-eval" in said


class Trained:
    """A checkpoint of LeRobot's with the dataset that it was trained on, or without."""

    def __init__(self, folder: Path, dataset: dict[str, Any] | None) -> None:
        self.policy, self.home = folder / "pretrained_model", folder / "home"
        self.policy.mkdir()
        (self.policy / "config.json").write_text('{"type": "act"}')
        if dataset is not None:
            (self.policy / "train_config.json").write_text(json.dumps({"dataset": dataset}))

    def recorded(self, place: Path, fps: object) -> None:
        (place / "meta").mkdir(parents=True)
        (place / "meta/info.json").write_text(json.dumps({"fps": fps}))


def test_the_rate_is_the_datasets(tmp_path: Path) -> None:
    trained = Trained(tmp_path, {"repo_id": "lab/lift", "root": str(tmp_path / "demos")})
    trained.recorded(tmp_path / "demos", 15)
    assert step_ns_of(trained.policy) == 66_666_666
    assert step_ns_of(trained.policy, fps=10) == 100_000_000
    # Trocar's own file says it of what it has converted or made.
    (trained.policy / "trocar.json").write_text('{"step_ns": 33333333}')
    assert step_ns_of(trained.policy) == 33_333_333


@pytest.mark.parametrize("place", ["lab/lift", "hub/datasets--lab--lift/snapshots/0123abc"])
@pytest.mark.parametrize("variable", ["HF_LEROBOT_HOME", "HF_HOME"])
def test_a_dataset_is_looked_for_where_lerobot_has_it(
    place: str, variable: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    trained = Trained(tmp_path, {"repo_id": "lab/lift", "root": None})
    monkeypatch.delenv("HF_LEROBOT_HOME", raising=False)
    monkeypatch.setenv(variable, str(trained.home))
    trained.recorded(trained.home / ("lerobot" if variable == "HF_HOME" else "") / place, 30)
    assert step_ns_of(trained.policy) == 33_333_333


def test_a_rate_that_nothing_says_is_asked_for(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("HF_LEROBOT_HOME", str(tmp_path / "home"))
    cases: list[tuple[dict[str, Any] | None, str]] = [
        (None, "neither trocar.json nor train_config.json"),
        ({"repo_id": "lab/lift"}, "'lab/lift' is not on this machine"),
    ]
    for index, (dataset, said) in enumerate(cases):
        folder = tmp_path / str(index)
        folder.mkdir()
        trained = Trained(folder, dataset)
        assert main(["serve", str(trained.policy)]) == 2
        told = capsys.readouterr().err
        assert said in told and "give --fps" in told
        assert step_ns_of(trained.policy, fps=15) == 66_666_666


@pytest.mark.parametrize("fps", [0, -15, 1001, 12.5, "15", None], ids=str)
def test_a_rate_that_is_none_is_refused(fps: Any, tmp_path: Path) -> None:
    trained = Trained(tmp_path, {"repo_id": "lab/lift", "root": str(tmp_path / "demos")})
    trained.recorded(tmp_path / "demos", fps)
    with pytest.raises(CheckpointError, match=rf"info\.json: fps = {fps!r}: allowed are 1 to 1000"):
        step_ns_of(trained.policy)
    (trained.policy / "trocar.json").write_text(json.dumps({"step_ns": fps}))
    with pytest.raises(CheckpointError, match=rf"trocar\.json: step_ns = {fps!r}: allowed are 1000000 to 1000000000"):
        step_ns_of(trained.policy)
    if isinstance(fps, int):
        with pytest.raises(CheckpointError, match=f"--fps = {fps}: allowed are 1 to 1000"):
            step_ns_of(trained.policy, fps)


def test_a_session_asks_within_what_a_slow_policy_answers() -> None:
    """The same as a trained policy of ours has it: `policy_steps` of runtime/app/src/session/training/save.rs."""
    assert [policy_steps(25, 1_000_000_000 // fps) for fps in (25, 50, 5, 30)] == [25, 12, 25, 20]
    assert policy_steps(1, 20_000_000) == 1
