#!/usr/bin/env python3
"""Writes trocar.json beside a policy that LeRobot 0.4 or newer saved, so that it can be run. Once, offline.

Requirements: none; with --least-deviation numpy safetensors

    python policy/convert/lerobot_recipe.py outputs/train/checkpoints/last/pretrained_model --actions absolute_pose --fps 25

Such a folder loads as it is; what it does not say is what its actions mean, how fast they follow each other, and how large the
cameras' frames are. A policy that LeRobot trained on a dataset of `trocar record` predicts that dataset's `action`: absolute_pose,
eight numbers an arm (position in the RCM frame, m; quaternion x, y, z, w; jaw, rad). One that was trained on actions relative to the
tip at the observation predicts observation_relative, seven numbers an arm.

A number that never changed in the demonstrations has a deviation of zero. LeRobot trains with that, and then multiplies whatever such a
joint measures by 1e8; here such statistics are refused. --least-deviation raises them, in the two statistics files, and says which:
for an action, nothing changes but rounding, since its mean is what comes out; for a state, the network is spared the noise.
"""

import argparse
import json
from pathlib import Path

import recipe
from recipe import fail

WIDTHS = {"absolute_pose": 8, "observation_relative": 7}


def raise_deviations(folder, least):
    """Every deviation of state and action below `least` becomes `least`."""
    from safetensors.numpy import load_file, save_file

    for file in sorted(folder.glob("policy_*processor_step_*.safetensors")):
        values = load_file(file)
        for feature in ("observation.state", "action"):
            deviation = values.get(f"{feature}.std")
            if deviation is None or not (deviation < least).any():
                continue
            raised = [int(place) for place in (deviation < least).nonzero()[0]]
            print(f"{file.name}: {feature}: deviations of dimensions {raised} raised to {least}")
            values[f"{feature}.std"] = deviation.clip(min=least)
        save_file(values, file)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--actions", choices=sorted(WIDTHS), required=True, help="what the actions mean")
    parser.add_argument("--fps", type=recipe.fps, required=True, help="steps of a chunk a second: the dataset's")
    recipe.add_shared_options(parser)
    parser.add_argument("--least-deviation", type=float, help="raise smaller deviations of state and action to this")
    options = parser.parse_args()

    file = options.folder / "config.json"
    config = json.loads(file.read_text())
    if config.get("type") != "act":
        fail(f"{file}: the policy is of type {config.get('type')!r}, expected 'act'")
    if (options.folder / "trocar.json").exists():
        fail(f"{options.folder / 'trocar.json'} is there already")
    state = config["input_features"]["observation.state"]["shape"][0]
    action = config["output_features"]["action"]["shape"][0]
    arms = state // 7
    if state % 7 or arms not in (1, 2) or action != arms * WIDTHS[options.actions]:
        fail(f"{file}: {state} numbers of state and {action} of action are not those of one or two arms with {options.actions}")
    cameras = {name: feature["shape"] for name, feature in config["input_features"].items() if feature["type"] == "VISUAL"}
    recorded = recipe.size_of(options.recorded, "--recorded") if options.recorded else None
    content = recipe.recipe(
        options,
        arms=arms,
        cameras={name: recorded or (shape[2], shape[1]) for name, shape in cameras.items()},
        query_every=max(1, config["chunk_size"] // 2),
        preset="lerobot",
        variants={"backbone_norm": "frozen_batch_norm", "loss_denominator": "valid"},
        made="trained with LeRobot",
    )
    if options.least_deviation is not None:
        if not 0 < options.least_deviation < 1:
            fail(f"--least-deviation {options.least_deviation} is outside (0, 1)")
        raise_deviations(options.folder, options.least_deviation)
    recipe.write_json(options.folder / "trocar.json", content)
    print(f"{options.folder / 'trocar.json'}: {arms} arm{'s' * (arms - 1)}, {len(cameras)} cameras, {options.actions}")


if __name__ == "__main__":
    main()
