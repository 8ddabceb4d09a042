"""What the converters share: reading pickles without running what is in them, and writing a checkpoint's folder, but for its trocar.json
(`recipe.py`)."""

import pickle
from pathlib import Path

import numpy as np
import torch
from safetensors.torch import save_file

from recipe import fail, write_json

IMAGENET = {"mean": [0.485, 0.456, 0.406], "std": [0.229, 0.224, 0.225]}
BEFORE = "policy_preprocessor_step_3_normalizer_processor.safetensors"
AFTER = "policy_postprocessor_step_0_unnormalizer_processor.safetensors"

# All that tensors, arrays and plain containers need. Nothing else out of a file is ever called.
HARMLESS = {
    ("collections", "OrderedDict"),
    ("builtins", "set"),
    ("torch._utils", "_rebuild_tensor_v2"),
    ("torch._utils", "_rebuild_parameter"),
    ("torch", "Size"),
    ("numpy", "ndarray"),
    ("numpy", "dtype"),
    ("numpy.core.multiarray", "_reconstruct"),
    ("numpy._core.multiarray", "_reconstruct"),
    ("numpy.core.multiarray", "scalar"),
    ("numpy._core.multiarray", "scalar"),
    ("numpy._core.numeric", "_frombuffer"),
    ("numpy.core.numeric", "_frombuffer"),
    ("_codecs", "encode"),
}


class Inert:
    """Stands for an object of any other class: keeps its state as data and does nothing."""

    def __init__(self, *arguments, **_named):
        self.arguments = arguments

    def __setstate__(self, state):
        self.state = state

    def __call__(self, *_arguments, **_named):
        return Inert()

    def __setitem__(self, _key, _value):
        pass

    def append(self, _item):
        pass

    def extend(self, _items):
        pass

    def __reduce__(self):
        raise TypeError("stands for something that was left unread")


class HarmlessUnpickler(pickle.Unpickler):
    """Builds tensors, arrays and containers; whatever else the file names becomes an Inert."""

    def find_class(self, module, name):
        storage = module in ("torch", "torch.storage") and (name.endswith("Storage") or isinstance(getattr(torch, name, None), torch.dtype))
        if storage or (module, name) in HARMLESS:
            return super().find_class(module, name)
        # A class of its own, since the pickle may ask for instances without calling it.
        return type(name, (Inert,), {})


class HarmlessPickle:
    """The module that torch.load is to unpickle with."""

    __name__ = "harmless"
    Unpickler = HarmlessUnpickler

    @staticmethod
    def load(file, **named):
        return HarmlessUnpickler(file, **named).load()


def load_checkpoint(path):
    """A .ckpt of torch.save, its tensors on the CPU."""
    return torch.load(path, map_location="cpu", weights_only=False, pickle_module=HarmlessPickle)


def load_pickle(path):
    with open(path, "rb") as file:
        return HarmlessUnpickler(file).load()


def plain(node):
    """An OmegaConf tree, which came in as inert objects, as plain values."""
    state = getattr(node, "state", node)
    if isinstance(state, dict) and "_content" in state:
        return plain(state["_content"])
    if isinstance(state, dict) and "_val" in state:
        return state["_val"]
    if isinstance(state, dict):
        return {key: plain(value) for key, value in state.items()}
    if isinstance(state, (list, tuple)):
        return [plain(value) for value in state]
    return state


def vector(name, values, width=None):
    """One feature's numbers in single precision; they must be as many as wanted, and finite."""
    found = torch.as_tensor(np.asarray(values), dtype=torch.float32).reshape(-1).contiguous()
    if width is not None and len(found) != width:
        fail(f"{name} has {len(found)} numbers, expected {width}")
    if not torch.isfinite(found).all():
        fail(f"{name} has a number that is not finite: {found.tolist()}")
    return found


def new_folder(path):
    path = Path(path)
    if path.exists() and (not path.is_dir() or any(path.iterdir())):
        fail(f"{path} exists and is not an empty folder")
    path.mkdir(parents=True, exist_ok=True)
    return path


def write_weights(folder, weights):
    for key, tensor in weights.items():
        if not torch.isfinite(tensor).all():
            fail(f"tensor {key} has a number that is not finite")
    save_file({key: tensor.detach().float().contiguous().clone() for key, tensor in weights.items()}, folder / "model.safetensors")


def act_features(cameras, height, width, state_dim, action_dim):
    inputs = {camera: {"type": "VISUAL", "shape": [3, height, width]} for camera in cameras}
    inputs["observation.state"] = {"type": "STATE", "shape": [state_dim]}
    return inputs, {"action": {"type": "ACTION", "shape": [action_dim]}}


def write_processors(folder, inputs, outputs, statistics):
    """The normaliser and un-normaliser as LeRobot 0.4 and later has them; `statistics` of state and action, by part."""
    mapping = {"VISUAL": "MEAN_STD", "STATE": "MEAN_STD", "ACTION": "MEAN_STD"}
    step = lambda name, config, **more: {"registry_name": name, "config": config, **more}
    device = step("device_processor", {"device": "cpu", "float_dtype": None})
    before = [
        step("rename_observations_processor", {"rename_map": {}}),
        step("to_batch_processor", {}),
        device,
        step("normalizer_processor", {"eps": 1e-8, "features": inputs | outputs, "norm_map": mapping}, state_file=BEFORE),
    ]
    after = [
        step("unnormalizer_processor", {"eps": 1e-8, "features": outputs, "norm_map": mapping}, state_file=AFTER),
        device,
    ]
    write_json(folder / "policy_preprocessor.json", {"name": "policy_preprocessor", "steps": before})
    write_json(folder / "policy_postprocessor.json", {"name": "policy_postprocessor", "steps": after})
    flat = {f"{feature}.{part}": value for feature, parts in statistics.items() for part, value in parts.items()}
    save_file({key: value for key, value in flat.items() if key.startswith("action.")}, folder / AFTER)
    for camera, feature in inputs.items():
        if feature["type"] == "VISUAL":
            for part, values in IMAGENET.items():
                flat[f"{camera}.{part}"] = torch.tensor(values).view(3, 1, 1)
    save_file(flat, folder / BEFORE)
