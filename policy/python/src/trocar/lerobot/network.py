"""Trocar's ACT networks as a policy of LeRobot's: its ACT with another backbone's normalisation, and actions made absolute."""

from __future__ import annotations

import copy
from collections import deque
from dataclasses import dataclass, field
from typing import Any

import torch
import torchvision
from lerobot.configs.policies import PreTrainedConfig
from lerobot.configs.types import FeatureType, PolicyFeature
from lerobot.policies.act.configuration_act import ACTConfig
from lerobot.policies.act.modeling_act import ACTPolicy
from lerobot.processor import ObservationProcessorStep, ProcessorStepRegistry
from torch import Tensor, nn
from torchvision.models._utils import IntermediateLayerGetter

from ..policy import ABSOLUTE, POLICY_STEP_NS, RELATIVE
from .adapter import STEP_NS, TIP_POSE
from .checkpoint import POLICY_TYPE

#: Channels of a group, as policy/nets/src/act/resnet.rs has them.
_CHANNELS_PER_GROUP = 16


@PreTrainedConfig.register_subclass(POLICY_TYPE)
@dataclass
class TrocarACTConfig(ACTConfig):
    """ACT as Trocar trains it."""

    #: ``group_norm`` or ``frozen_batch_norm``.
    backbone_norm: str = "group_norm"
    #: Stages of the ResNet that are used, 3 or 4.
    backbone_stages: int = 4
    #: Whether the network answers relative to the tip at the observation.
    relative: bool = True
    #: Time between two steps of a chunk, ns.
    step_ns: int = POLICY_STEP_NS


class TrocarACTPolicy(ACTPolicy):
    """Answers with absolute actions in SI units; wants ``observation.tip_pose`` beside LeRobot's features."""

    config_class = TrocarACTConfig
    name = POLICY_TYPE

    def __init__(self, config: TrocarACTConfig, **kwargs: Any) -> None:
        self_arms = config.output_features["action"].shape[0] // ABSOLUTE
        numbers = (RELATIVE if config.relative else ABSOLUTE) * self_arms
        network = copy.copy(config)
        network.output_features = {"action": PolicyFeature(type=FeatureType.ACTION, shape=(numbers,))}
        super().__init__(network, **kwargs)
        self.config = config
        self.arms = self_arms
        self.register_buffer("action_mean", torch.zeros(numbers))
        self.register_buffer("action_std", torch.ones(numbers))
        if config.backbone_norm == "group_norm" or config.backbone_stages != 4:
            self.model.backbone = _backbone(config)
            channels = 64 * 2 ** (config.backbone_stages - 1)
            self.model.encoder_img_feat_input_proj = nn.Conv2d(channels, config.dim_model, kernel_size=1)

    @torch.no_grad()
    def predict_action_chunk(self, batch: dict[str, Tensor]) -> Tensor:
        """Absolute actions (batch, steps, 8 an arm): x, y, z (m), quaternion x, y, z, w in the RCM frame, jaw (rad)."""
        actions = super().predict_action_chunk(batch) * self.action_std + self.action_mean
        return absolute(actions, batch[TIP_POSE], self.arms) if self.config.relative else actions

    def reset(self) -> None:
        """An episode begins."""
        super().reset()
        # LeRobot's own has room for as many actions as there are policy steps from one query to the next.
        self._action_queue: deque[Tensor] = deque()

    @torch.no_grad()
    def select_action(self, batch: dict[str, Tensor]) -> Tensor:
        """The next absolute action (batch, 8 an arm) of an environment: what lies at the end of its step in the newest chunk, whatever the
        chunk's own steps.

        The environment's steps are as long as `batch` says, 40 ms if it does not. Raises ValueError if they are others than the chunk's and
        chunks are to be ensembled.
        """
        own_ns = self.config.step_ns
        step_ns = int(batch[STEP_NS][0]) if STEP_NS in batch else POLICY_STEP_NS
        if self.config.temporal_ensemble_coeff is not None:
            # It mixes a row of each chunk a step.
            if step_ns != own_ns:
                raise ValueError(
                    f"temporal_ensemble_coeff = {self.config.temporal_ensemble_coeff} with steps of {own_ns} ns in an environment with steps "
                    f"of {step_ns} ns: allowed is null, or the same steps"
                )
            return self.temporal_ensembler.update(resampled(self.predict_action_chunk(batch), self.arms, own_ns, step_ns))
        if not self._action_queue:
            actions = resampled(self.predict_action_chunk(batch), self.arms, own_ns, step_ns)
            # As long as a session plays them before it asks anew.
            count = max(self.config.n_action_steps * POLICY_STEP_NS // step_ns, 1)
            self._action_queue.extend(actions[:, :count].transpose(0, 1))
        return self._action_queue.popleft()


def _backbone(config: TrocarACTConfig) -> nn.Module:
    norm: Any = torchvision.ops.FrozenBatchNorm2d
    if config.backbone_norm == "group_norm":
        norm = lambda channels: nn.GroupNorm(channels // _CHANNELS_PER_GROUP, channels)  # noqa: E731
    whole = torchvision.models.resnet18(weights=None, norm_layer=norm)
    return IntermediateLayerGetter(whole, return_layers={f"layer{config.backbone_stages}": "feature_map"})


def absolute(actions: Tensor, tips: Tensor, arms: int) -> Tensor:
    """Absolute actions (batch, steps, 8 an arm) of relative ones (batch, steps, 7 an arm) for tips (batch, 7 an arm)."""
    rows = actions.unflatten(-1, (arms, RELATIVE))
    tip = tips.unflatten(-1, (arms, 7)).unsqueeze(1)
    vector = rows[..., 3:6]
    half = 0.5 * torch.linalg.vector_norm(vector, dim=-1, keepdim=True)
    turned = torch.cat([0.5 * torch.sinc(half / torch.pi) * vector, torch.cos(half)], dim=-1)
    quaternion = _product(tip[..., 3:7].expand_as(turned), turned)
    return torch.cat([tip[..., :3] + rows[..., :3], quaternion, rows[..., 6:]], dim=-1).flatten(-2)


def resampled(actions: Tensor, arms: int, from_ns: int, to_ns: int) -> Tensor:
    """A chunk of absolute actions (batch, steps, 8 an arm), `from_ns` apart, as actions of an environment with steps of `to_ns`.

    Row k of a chunk is due k of its steps after the observation: a network learns it from the dataset's ``action`` k frames later, the target at
    that frame. An environment reaches an action at the end of its step, so that of step k is what lies k + 1 of its steps after the observation.
    The last one, of a step that ends beyond the chunk, is the last row. Between two rows position and jaw are interpolated linearly, the
    rotation along the shortest arc.
    """
    last = actions.shape[1] - 1
    end_ns = last * from_ns
    due = ((torch.arange(end_ns // to_ns + 1, device=actions.device) + 1) * to_ns).clamp(max=end_ns)
    index = due // from_ns
    share = ((due % from_ns).to(actions.dtype) / from_ns)[:, None, None]
    rows = actions.unflatten(-1, (arms, ABSOLUTE))
    before, after = rows[:, index], rows[:, (index + 1).clamp(max=last)]
    mixed = torch.lerp(before, after, share)
    first, second = before[..., 3:7], after[..., 3:7]
    cosine = (first * second).sum(-1, keepdim=True)
    angle = torch.arccos(cosine.abs().clamp(max=1.0))
    # sin(part * angle) / sin(angle), which is `part` of no angle; its sign that of the nearer of the two quaternions that are one rotation.
    weights = [part * torch.sinc(part * angle / torch.pi) / torch.sinc(angle / torch.pi) for part in (1 - share, share)]
    turned = weights[0] * first + torch.copysign(weights[1], cosine) * second
    turned = turned / torch.linalg.vector_norm(turned, dim=-1, keepdim=True)
    return torch.cat([mixed[..., :3], turned, mixed[..., 7:]], dim=-1).flatten(-2)


def _product(a: Tensor, b: Tensor) -> Tensor:
    av, aw, bv, bw = a[..., :3], a[..., 3:], b[..., :3], b[..., 3:]
    vector = aw * bv + bw * av + torch.cross(av, bv, dim=-1)
    return torch.cat([vector, aw * bw - (av * bv).sum(-1, keepdim=True)], dim=-1)


@ProcessorStepRegistry.register(name="trocar_area_average")
@dataclass
class AreaAverage(ObservationProcessorStep):
    """Brings images (batch, 3, height, width), 0 to 1, to the network's size, as Trocar does: blocks averaged, rounded to bytes."""

    #: Height and width by feature.
    sizes: dict[str, list[int]] = field(default_factory=dict)

    def observation(self, observation: dict[str, Any]) -> dict[str, Any]:
        """The observation with its images at their sizes."""
        return observation | {
            name: _averaged(observation[name], size) for name, size in self.sizes.items() if name in observation
        }

    def get_config(self) -> dict[str, Any]:
        """What the step is made of."""
        return {"sizes": self.sizes}

    def transform_features(self, features: Any) -> Any:
        """The features as they are: sizes of images are the environment's."""
        return features


def _averaged(images: Tensor, size: list[int]) -> Tensor:
    height, width = size
    factor = images.shape[-2] // height
    if factor < 1 or tuple(images.shape[-2:]) != (factor * height, factor * width):
        raise ValueError(
            f"images of {images.shape[-1]}x{images.shape[-2]} are no whole multiple of {width}x{height}: "
            "give the environment another size"
        )
    if factor == 1:
        return images
    sums = torch.nn.functional.avg_pool2d((images * 255).round(), factor, divisor_override=1)
    return torch.floor((sums + factor * factor // 2) / (factor * factor)) / 255


