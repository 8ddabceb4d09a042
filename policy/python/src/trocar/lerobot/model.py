"""Checkpoints as LeRobot's own classes load and run them."""

from __future__ import annotations

import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch
from lerobot.configs.policies import PreTrainedConfig
from lerobot.configs.types import FeatureType
from lerobot.policies.factory import get_policy_class, make_pre_post_processors

from . import register
from .adapter import IMAGES, STATE, Features, Floats, ServedPolicy
from .checkpoint import CheckpointError, convert, policy_steps, recipe_of, wants_conversion


class LoadedModel:
    """A policy of LeRobot's with its processors, loaded strictly: no key may be missing or left over."""

    def __init__(self, folder: Path, device: str = "cpu") -> None:
        config = PreTrainedConfig.from_pretrained(folder)
        config.device = device
        config.pretrained_path = folder
        self.policy: Any = get_policy_class(config.type).from_pretrained(folder, config=config, strict=True)
        self.policy.eval()
        overrides = {"device_processor": {"device": device}}
        self._before, self._after = make_pre_post_processors(
            config, pretrained_path=str(folder), preprocessor_overrides=overrides
        )
        self._config = config

    @property
    def features(self) -> Features:
        """What it is shown and answers."""
        inputs, outputs = self._config.input_features, self._config.output_features
        images = {
            name.removeprefix(IMAGES): (int(feature.shape[1]), int(feature.shape[2]))
            for name, feature in inputs.items()
            if feature.type is FeatureType.VISUAL
        }
        state = inputs.get(STATE)
        if state is None:
            raise CheckpointError(f"{self._config.pretrained_path}: the policy is not shown {STATE}")
        steps = int(getattr(self._config, "n_obs_steps", 1))
        return Features(images, state.shape[0], outputs["action"].shape[0], steps)

    @property
    def query_every(self) -> int:
        """Its steps from one query to the next: half of those that it would execute, so that a late answer still meets the one before."""
        return max(1, int(getattr(self._config, "n_action_steps", 1)) // 2)

    def __call__(self, batch: Mapping[str, Floats], instruction: str) -> Floats:
        """The chunk (steps, numbers) for a batch of one."""
        inputs: dict[str, Any] = {name: torch.from_numpy(value) for name, value in batch.items()}
        inputs["task"] = [instruction]
        with torch.inference_mode():
            answer = self._after(self.policy.predict_action_chunk(self._before(inputs)))
        found: Floats = answer[0].to("cpu", torch.float32).numpy()
        return found

    def seeded(self, seed: int) -> None:
        """An episode begins: what is random depends on `seed`."""
        torch.manual_seed(seed % 2**63)
        self.policy.reset()


def load(folder: Path, step_ns: int, device: str = "cpu") -> tuple[ServedPolicy, int]:
    """The policy in `folder`, LeRobot's or Trocar's, whose steps last `step_ns`, to be served.

    And the policy steps from one query to the next.
    """
    register()
    recipe = recipe_of(folder)
    with tempfile.TemporaryDirectory() as made:
        loaded = convert(folder, Path(made) / "converted") if wants_conversion(folder) else folder
        model = LoadedModel(loaded, device)
    every = int(recipe["query_every_steps"]) if recipe is not None else policy_steps(model.query_every, step_ns)
    return ServedPolicy(model, model.features, model.seeded, step_ns), every
