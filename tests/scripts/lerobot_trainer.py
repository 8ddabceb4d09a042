"""The step of LeRobot's own trainer, for `training_peers.py`: lerobot==0.6.1 with its policy, optimiser, processors and accelerate.

Requirements: torch torchvision numpy lerobot==0.6.1 accelerate einops draccus mergedeep typing-inspect gymnasium
farama-notifications termcolor safetensors huggingface_hub opencv-python-headless

`lerobot.scripts.lerobot_train`, which holds the step, imports at its head the parts of LeRobot that read datasets and that submit
to a job service. Those need the packages `datasets` and `av`, and nothing of them is used in a step. On a machine without these
packages, empty modules take the places of those parts (`SET_ASIDE` names them then); everything that computes is LeRobot's.
"""

import importlib.abc
import importlib.machinery
import importlib.util
import sys

import torch

VERSION = "0.6.1"
UNUSED = ("lerobot.datasets", "lerobot.jobs")
MISSING = [name for name in ("datasets", "av") if importlib.util.find_spec(name) is None]
SET_ASIDE = UNUSED if MISSING else ()


class Empty(importlib.abc.MetaPathFinder, importlib.abc.Loader):
    """Modules whose names are all classes that can be asked for, but neither made nor called."""

    def find_spec(self, name, path=None, target=None):
        if ".".join(name.split(".")[:2]) in SET_ASIDE:
            return importlib.machinery.ModuleSpec(name, self, is_package=True)
        return None

    def create_module(self, spec):
        return None

    def exec_module(self, module):
        def refuse(*_, **__):
            raise RuntimeError(f"{module.__name__} was set aside, for want of {' and '.join(MISSING)}")

        def attribute(name):
            if name.startswith("__"):
                raise AttributeError(name)
            return type(name, (), {"__init__": refuse})

        module.__getattr__ = attribute


sys.meta_path.insert(0, Empty())

import lerobot
from accelerate import Accelerator
from accelerate.state import AcceleratorState
from accelerate.utils import DistributedDataParallelKwargs
from lerobot.configs.types import FeatureType, PolicyFeature
from lerobot.policies.act.configuration_act import ACTConfig
from lerobot.policies.act.modeling_act import ACTPolicy
from lerobot.policies.factory import make_pre_post_processors
from lerobot.scripts.lerobot_train import update_policy
from lerobot.utils.constants import IMAGENET_STATS
from lerobot.utils.logging_utils import AverageMeter, MetricsTracker

if lerobot.__version__ != VERSION:
    raise ImportError(f"lerobot {lerobot.__version__}, not {VERSION}, whose trainer is repeated here")


class Trainer:
    """LeRobot's training of ACT but for the reading of its dataset; made in the order of its `train`."""

    def __init__(self, sizes, info, backbone, batch, device, bf16):
        self.cameras = info["cameras"]
        # Mixed precision is accelerate's, as there.
        self.accelerator = Accelerator(
            step_scheduler_with_optimizer=False,
            mixed_precision="bf16" if bf16 else None,
            kwargs_handlers=[DistributedDataParallelKwargs(find_unused_parameters=True)],
            cpu=device.type == "cpu",
        )
        torch.backends.cudnn.benchmark = True
        torch.backends.cuda.matmul.allow_tf32 = True
        config = act_config(sizes, info, device)
        policy = ACTPolicy(config)
        policy.model.backbone.load_state_dict(backbone)
        policy.to(config.device)
        self.elements = sum(value.numel() for value in policy.state_dict().values())
        self.preprocessor, _ = make_pre_post_processors(config, dataset_stats=statistics(info))
        preset = config.get_optimizer_preset()
        self.clip = preset.grad_clip_norm
        assert config.get_scheduler_preset() is None
        optimiser = preset.build(policy.get_optim_params())
        self.policy, self.optimiser = self.accelerator.prepare(policy, optimiser)
        self.policy.train()
        names = ["loss", "grad_norm", "lr", "update_s", "dataloading_s", "samples_per_s", "gpu_mem_gb"]
        meters = {name: AverageMeter(name) for name in names}
        self.tracker = MetricsTracker(batch, 1000, 10, meters, accelerator=self.accelerator)

    def prepared(self, batch):
        """What its loop does with a batch that its loader gave: images are bytes, channels first."""
        for name in self.cameras:
            batch[name] = batch[name].to(dtype=torch.float32) / 255.0
        return self.preprocessor(batch)

    def update(self, batch):
        """Its step, with everything that it keeps account of."""
        self.tracker, _ = update_policy(
            self.tracker, self.policy, batch, self.optimiser, self.clip, accelerator=self.accelerator
        )
        self.tracker.step()


def forget():
    """Has accelerate forget its precision, which is one for a process: a trainer of another can be made."""
    AcceleratorState._reset_state(reset_partial_state=True)


def act_config(sizes, info, device):
    chunk, width, heads, hidden, layers, decoders, side = sizes
    inputs = {name: PolicyFeature(FeatureType.VISUAL, (3, side, side)) for name in info["cameras"]}
    inputs["observation.state"] = PolicyFeature(FeatureType.STATE, (info["state"],))
    return ACTConfig(
        input_features=inputs,
        output_features={"action": PolicyFeature(FeatureType.ACTION, (info["action"],))},
        chunk_size=chunk,
        n_action_steps=chunk,
        dim_model=width,
        n_heads=heads,
        dim_feedforward=hidden,
        n_encoder_layers=layers,
        n_decoder_layers=decoders,
        pretrained_backbone_weights=None,
        device=device.type,
        push_to_hub=False,
    )


def statistics(info):
    """Of numbers that are normalised already: to normalise them once more is the same work."""
    made = {
        name: {"mean": torch.zeros(info[key]), "std": torch.ones(info[key])}
        for name, key in (("observation.state", "state"), ("action", "action"))
    }
    return made | {name: {part: torch.tensor(values) for part, values in IMAGENET_STATS.items()} for name in info["cameras"]}
