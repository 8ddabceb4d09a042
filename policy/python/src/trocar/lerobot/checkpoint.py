"""Trocar's checkpoints of ACT as folders that LeRobot loads, with the policy class of `trocar.lerobot.network`."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

import numpy as np
from safetensors.numpy import load_file, save_file

from ..policy import POLICY_STEP_NS, STEP_NS_MAX, STEP_NS_MIN

#: The type of the converted folders.
POLICY_TYPE = "trocar_act"

#: Policies of LeRobot's that answer only from observations which they have queued themselves, one a step.
_QUEUES = ("vqbet", "multi_task_dit")

_REPRESENTATIONS = {"observation_relative": 7, "absolute_pose": 8}
_PREPROCESSOR = "policy_preprocessor"
_POSTPROCESSOR = "policy_postprocessor"
_STATISTICS = "policy_preprocessor_step_3_normalizer_processor.safetensors"


#: Most frames a second of a dataset: steps of 1 ms.
FPS_MAX = 1000


class CheckpointError(ValueError):
    """A checkpoint's folder can't be used; the message has the file and the reason."""


def read_json(file: Path) -> dict[str, Any]:
    """The object in `file`."""
    try:
        found = json.loads(file.read_text())
    except OSError as error:
        raise CheckpointError(f"{file}: {error.strerror}") from error
    except ValueError as error:
        raise CheckpointError(f"{file}: {error}") from error
    if not isinstance(found, dict):
        raise CheckpointError(f"{file}: an object is wanted")
    return found


def recipe_of(folder: Path) -> dict[str, Any] | None:
    """What ``trocar.json`` says, if the folder has one."""
    file = folder / "trocar.json"
    return read_json(file) if file.exists() else None


def step_ns_of(folder: Path, fps: int | None = None) -> int:
    """Time between two steps of what the policy in `folder` answers, ns: by `fps`, or else as ``trocar.json`` says, or else the dataset.

    LeRobot writes into ``train_config.json`` beside the policy which dataset it was trained on, and into the dataset's ``meta/info.json``
    its frames a second; the dataset is looked for where LeRobot has it, on this machine.

    Raises CheckpointError if nothing says it, or what says it is out of range.
    """
    said_by = "--fps"
    if fps is None:
        recipe = recipe_of(folder)
        if recipe is not None:
            return _checked_step_ns(folder / "trocar.json", recipe.get("step_ns"))
        info = _info_of_dataset(folder)
        fps, said_by = read_json(info).get("fps"), f"{info}: fps"
    if not isinstance(fps, int) or not 1 <= fps <= FPS_MAX:
        raise CheckpointError(f"{said_by} = {fps!r}: allowed are 1 to {FPS_MAX}, whole frames a second")
    return 1_000_000_000 // fps


def policy_steps(steps: int, step_ns: int) -> int:
    """`steps` of a policy's, of `step_ns` each, as policy steps of 40 ms, by which a session asks.

    No more than they last, and no more of them.
    """
    return min(max(steps * step_ns // POLICY_STEP_NS, 1), steps)


def _checked_step_ns(file: Path, step_ns: Any) -> int:
    if not isinstance(step_ns, int) or not STEP_NS_MIN <= step_ns <= STEP_NS_MAX:
        raise CheckpointError(f"{file}: step_ns = {step_ns!r}: allowed are {STEP_NS_MIN} to {STEP_NS_MAX}")
    return step_ns


def _info_of_dataset(folder: Path) -> Path:
    """``meta/info.json`` of the dataset that the policy in `folder` was trained on."""
    file = folder / "train_config.json"
    wanted = "so nothing says how fast its steps follow each other: give --fps, the frames a second of the dataset that it was trained on"
    if not file.exists():
        raise CheckpointError(f"{folder}: neither trocar.json nor train_config.json is there, {wanted}")
    dataset = read_json(file).get("dataset")
    root, name = (dataset.get(key) for key in ("root", "repo_id")) if isinstance(dataset, dict) else (None, None)
    home = Path(os.environ.get("HF_LEROBOT_HOME") or Path(os.environ.get("HF_HOME") or "~/.cache/huggingface") / "lerobot").expanduser()
    places: list[Path] = []
    if isinstance(root, str):
        places = [Path(root).expanduser()]
    elif isinstance(name, str):
        snapshots = home / "hub" / f"datasets--{name.replace('/', '--')}" / "snapshots"
        places = [home / name, *sorted(snapshots.glob("*"))]
    for place in places:
        if (place / "meta/info.json").exists():
            return place / "meta/info.json"
    raise CheckpointError(f"{file}: the dataset {root or name!r} is not on this machine, {wanted}")


def wants_conversion(folder: Path) -> bool:
    """Whether LeRobot's own classes can't load the folder: its backbone is normalised in groups, or has three stages."""
    config = read_json(folder / "config.json")
    recipe = recipe_of(folder)
    if recipe is None or config.get("type") == POLICY_TYPE:
        return False
    return _is_grouped(config, recipe) or _has_three_stages(config)


def check_served(folder: Path) -> None:
    """Raises CheckpointError if the policy in `folder` can't be asked for a chunk."""
    file = folder / "config.json"
    kind = read_json(file).get("type")
    if kind in _QUEUES:
        raise CheckpointError(
            f"{file}: type = {kind!r} can't be served: it answers from observations that it has queued itself, one a step, and not for the "
            "one that it is asked about; lerobot-eval --env.type=trocar runs it"
        )


def convert(folder: Path, out: Path) -> Path:
    """Writes Trocar's ACT checkpoint `folder` to `out` as LeRobot loads it: single precision, without the variational encoder.

    The policy takes the frames at the size of the task's cameras, and answers with absolute poses. Its chunks have the steps that it was
    trained with; LeRobot's programs, which ask for one action an environment's step, get what lies at the end of that step in them.

    Raises CheckpointError if the folder has no network of ACT's, or `out` is there already.
    """
    config = read_json(folder / "config.json")
    recipe = recipe_of(folder)
    if recipe is None:
        raise CheckpointError(f"{folder / 'trocar.json'}: missing: without it nothing says what the actions mean")
    if config.get("type") != "act":
        raise CheckpointError(f"{folder / 'config.json'}: type = {config.get('type')!r}: allowed is 'act'")
    if out.exists():
        raise CheckpointError(f"{out}: is there already")
    step_ns = _checked_step_ns(folder / "trocar.json", recipe.get("step_ns"))
    arms, meant = int(recipe["arms"]), recipe["action_representation"]
    if meant not in _REPRESENTATIONS:
        raise CheckpointError(
            f"{folder / 'trocar.json'}: action_representation = {meant!r}: allowed are {', '.join(_REPRESENTATIONS)}"
        )
    out.mkdir(parents=True)
    statistics = {key: value.astype(np.float32) for key, value in load_file(folder / _STATISTICS).items()}
    _write(out / "config.json", _config(config, recipe, arms, meant, step_ns))
    tensors = {key: value.astype(np.float32) for key, value in load_file(folder / "model.safetensors").items()}
    tensors = {key: value for key, value in tensors.items() if not key.startswith("model.vae_")}
    tensors |= {"action_mean": statistics["action.mean"], "action_std": statistics["action.std"]}
    save_file(tensors, out / "model.safetensors", metadata={"format": "pt"})
    save_file(statistics, out / _STATISTICS)
    _write(out / f"{_PREPROCESSOR}.json", _preprocessor(read_json(folder / f"{_PREPROCESSOR}.json"), config))
    _write(out / f"{_POSTPROCESSOR}.json", {"name": _POSTPROCESSOR, "steps": [_to_device()]})
    _write(out / "trocar.json", recipe | {"action_representation": "absolute_pose"})
    return out


def _is_grouped(config: dict[str, Any], recipe: dict[str, Any]) -> bool:
    norm = recipe.get("variants", {}).get("backbone_norm")
    return norm == "group_norm" or str(config.get("vision_backbone", "")).startswith("group_norm")


def _has_three_stages(config: dict[str, Any]) -> bool:
    return str(config.get("vision_backbone", "")).endswith("_stages3")


def _config(config: dict[str, Any], recipe: dict[str, Any], arms: int, meant: str, step_ns: int) -> dict[str, Any]:
    query_every = min(int(recipe["query_every_steps"]), int(config["chunk_size"]))
    return config | {
        "type": POLICY_TYPE,
        "vision_backbone": "resnet18",
        "backbone_norm": "group_norm" if _is_grouped(config, recipe) else "frozen_batch_norm",
        "backbone_stages": 3 if _has_three_stages(config) else 4,
        "relative": meant == "observation_relative",
        "step_ns": step_ns,
        "use_vae": False,
        "n_action_steps": query_every,
        "output_features": {"action": {"type": "ACTION", "shape": [8 * arms]}},
    }


def _preprocessor(steps: dict[str, Any], config: dict[str, Any]) -> dict[str, Any]:
    """The folder's own steps, with frames brought to the network's size first."""
    sizes = {
        name: list(feature["shape"][1:])
        for name, feature in config["input_features"].items()
        if feature["type"] == "VISUAL"
    }
    shrink = {"registry_name": "trocar_area_average", "config": {"sizes": sizes}}
    found = list(steps["steps"])
    place = next(index for index, step in enumerate(found) if step["registry_name"] == "normalizer_processor")
    return {"name": _PREPROCESSOR, "steps": [*found[:place], shrink, *found[place:]]}


def _to_device() -> dict[str, Any]:
    return {"registry_name": "device_processor", "config": {"device": "cpu", "float_dtype": None}}


def _write(file: Path, content: dict[str, Any]) -> None:
    file.write_text(json.dumps(content, indent=2, sort_keys=True) + "\n")
