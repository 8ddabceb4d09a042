#!/usr/bin/env python3
"""An ACT directory of LeRobot 0.3.3 or older, whose statistics are among the weights, into one as 0.4 and later has it. Once, offline.

Requirements: torch numpy safetensors

    python policy/convert/legacy_lerobot.py OLD_FOLDER --out runs/act [--actions observation_relative --fps FPS]

Images must have been normalised with ImageNet's statistics, LeRobot's default; with a dataset's own the network would see other
colours here, so that is refused.
"""

import argparse
import json
from pathlib import Path

import torch
from safetensors.torch import load_file

import common
import recipe

NORMALISERS = ("normalize_inputs.", "normalize_targets.", "unnormalize_outputs.")


def buffer(statistics, normaliser, feature, part):
    # Dots in a feature's name became underscores, since a module's name has none.
    key = f"{normaliser}.buffer_{feature.replace('.', '_')}.{part}"
    if key not in statistics:
        common.fail(f"model.safetensors has no {key}: is this a folder of LeRobot 0.3.3 or older?")
    return statistics[key]


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--out", required=True)
    recipe.add_options(parser)
    options = recipe.parsed(parser)

    config = json.loads((options.folder / "config.json").read_text())
    if config.get("type") != "act":
        common.fail(f"{options.folder / 'config.json'}: the policy is of type {config.get('type')!r}, expected 'act'")
    for kind, mode in config["normalization_mapping"].items():
        if mode != "MEAN_STD":
            common.fail(f"normalization_mapping.{kind} = {mode} is not supported, expected MEAN_STD")
    tensors = load_file(options.folder / "model.safetensors")
    weights = {key: value for key, value in tensors.items() if not key.startswith(NORMALISERS)}
    inputs, outputs = config["input_features"], config["output_features"]
    cameras = [name for name, feature in inputs.items() if feature["type"] == "VISUAL"]
    for camera in cameras:
        for part, expected in common.IMAGENET.items():
            found = buffer(tensors, "normalize_inputs", camera, part).reshape(-1)
            if len(found) != 3 or not torch.allclose(found, torch.tensor(expected), atol=1e-4):
                common.fail(f"{camera}: {part} is {found.tolist()}, not ImageNet's {expected}")
    statistics = {}
    for feature, normaliser, shape in (
        ("observation.state", "normalize_inputs", inputs["observation.state"]["shape"]),
        ("action", "unnormalize_outputs", outputs["action"]["shape"]),
    ):
        statistics[feature] = {
            part: common.vector(f"{feature}.{part}", buffer(tensors, normaliser, feature, part), shape[0]) for part in ("mean", "std")
        }
    folder = common.new_folder(options.out)
    common.write_weights(folder, weights)
    common.write_processors(folder, inputs, outputs, statistics)
    common.write_json(folder / "config.json", config)
    _, height, width = inputs[cameras[0]]["shape"] if cameras else common.fail("there is no camera")
    state_dim = inputs["observation.state"]["shape"][0]
    variants = {"backbone_norm": "frozen_batch_norm", "loss_denominator": "all"}
    every = max(1, config["chunk_size"] // 2)
    recipe.write(folder, options, options.folder, "lerobot", cameras, (width, height), state_dim, every, variants)
    print(f"{len(weights)} tensors, statistics of {len(statistics) + len(cameras)} features, in {folder}")


if __name__ == "__main__":
    main()
