#!/usr/bin/env python3
"""DP3's or SimpleDP3's `.ckpt` into a checkpoint's folder. Once, offline.

Requirements: torch numpy safetensors

    python policy/convert/dp3_ckpt.py latest.ckpt --cameras endoscope --recorded 512x512 --out runs/dp3 \
        --actions observation_relative --fps 25 --frame scene

The averaged weights (`ema_model`) are taken, as the authors evaluate them. Nothing in the file is run: its configuration is read
as data, whatever else is no tensor is left unread. Sizes come from the weights; horizon and steps from the configuration in the
file, or from --horizon and --n-action-steps.

Refused, since this project has no such network: colour in the point cloud, another condition than FiLM, layers without their norm,
a normaliser that is not "limits". How the clouds were made is not in the file: the options say it, and they must say what the
training did. A folder of DP3 always has a trocar.json, so --actions and --fps must be given; without --query-every it is asked after
n_action_steps of its own.
"""

import argparse
import re

import torch
from safetensors.torch import save_file

import common
import recipe

DROPPED = ("normalizer.", "mask_generator.", "_dummy_variable")
# Least deviation that is written: DP3 normalises by limits and has no use for it, but a reader refuses none.
STD_MIN = 1e-6


def averaged(checkpoint):
    states = checkpoint.get("state_dicts") if isinstance(checkpoint, dict) else None
    if not isinstance(states, dict) or "model" not in states:
        common.fail("no state_dicts.model in the file: this is no DP3 checkpoint")
    if "ema_model" not in states:
        print("there is no ema_model: training was without the average, the weights themselves are taken")
    return states.get("ema_model", states["model"])


def limits(state, feature):
    """Range and moments of a feature, and the check that its scale and offset are those of its range."""
    of = lambda name: state.get(f"normalizer.params_dict.{feature}.{name}")
    parts = {name: of(f"input_stats.{name}") for name in ("min", "max", "mean", "std")}
    for name, value in parts.items() | {("scale", of("scale")), ("offset", of("offset"))}:
        if value is None:
            common.fail(f"the normaliser of {feature} has no {name}")
    parts = {name: common.vector(f"{feature}.{name}", value) for name, value in parts.items()}
    span = parts["max"] - parts["min"]
    constant = span < 1e-4
    scale = torch.where(constant, torch.ones_like(span), 2 / torch.where(constant, torch.ones_like(span), span))
    offset = torch.where(constant, -parts["min"], -1 - scale * parts["min"])
    for name, expected in (("scale", scale), ("offset", offset)):
        found = common.vector(f"{feature}.{name}", of(name))
        if not torch.allclose(found, expected, rtol=1e-4, atol=1e-5):
            common.fail(f"the normaliser of {feature} is not by limits: {name} is {found.tolist()}, expected {expected.tolist()}")
    parts["std"] = parts["std"].clamp_min(STD_MIN)
    return parts


def network_of(weights, cfg, options):
    shape = lambda key: tuple(weights[key].shape) if key in weights else common.fail(f"tensor {key} is missing")
    if shape("obs_encoder.extractor.mlp.0.weight")[1] != 3:
        common.fail("the point cloud has colour, which this project's DP3 has not")
    if "obs_encoder.extractor.mlp.1.weight" not in weights or "obs_encoder.extractor.final_projection.1.weight" not in weights:
        common.fail("the point encoder has no layer norms, which this project's DP3 has")
    step_dim = shape("model.diffusion_step_encoder.3.weight")[0]
    features = shape("obs_encoder.extractor.final_projection.0.weight")[0]
    down = []
    while f"model.down_modules.{len(down)}.0.blocks.0.block.0.weight" in weights:
        down.append(shape(f"model.down_modules.{len(down)}.0.blocks.0.block.0.weight")[0])
    film = shape("model.down_modules.0.0.cond_encoder.1.weight")
    if film[0] != 2 * down[0]:
        common.fail("the condition is not by FiLM with scale and bias")
    observed = film[1] - step_dim
    per_observation = features + 64
    if observed % per_observation:
        common.fail(f"{observed} features of the observations are no multiple of {per_observation}")
    blocks = 2 if "model.mid_modules.1.blocks.0.block.0.weight" in weights else 1
    policy = cfg.get("policy", {}) if isinstance(cfg, dict) else {}
    scheduler = policy.get("noise_scheduler", {})
    check_scheduler(scheduler)
    chosen = lambda name, default: getattr(options, name, None) or cfg.get(name) or default
    return {
        "horizon": int(chosen("horizon", 16)),
        "n_obs_steps": observed // per_observation,
        "n_action_steps": int(chosen("n_action_steps", 8)),
        "encoder_output_dim": features,
        "diffusion_step_embed_dim": step_dim,
        "down_dims": down,
        "kernel_size": shape("model.down_modules.0.0.blocks.0.block.0.weight")[2],
        "n_groups": int(policy.get("n_groups") or 8),
        "blocks": blocks,
        "num_train_timesteps": int(scheduler.get("num_train_timesteps") or 100),
        "num_inference_steps": int(policy.get("num_inference_steps") or 10),
        "state_dim": shape("obs_encoder.state_mlp.0.weight")[1],
        "action_dim": shape("model.final_conv.1.weight")[0],
    }


def check_scheduler(scheduler):
    expected = {
        "beta_schedule": "squaredcos_cap_v2",
        "clip_sample": True,
        "set_alpha_to_one": True,
        "steps_offset": 0,
        "prediction_type": "sample",
    }
    for name, value in expected.items():
        if scheduler.get(name, value) != value:
            common.fail(f"noise_scheduler.{name} = {scheduler[name]} is not supported, expected {value}")
    kind = str(scheduler.get("_target_", "DDIMScheduler"))
    if not kind.endswith("DDIMScheduler"):
        common.fail(f"noise_scheduler is {kind}, expected DDIMScheduler")


def cloud_of(options):
    corners = None
    if options.crop:
        numbers = [float(x) for x in options.crop.split(",")]
        if len(numbers) != 6:
            common.fail(f"--crop {options.crop}: expected six numbers")
        corners = [numbers[:3], numbers[3:]]
    dropped = [int(x) for x in options.dropped_instances.split(",") if x]
    return {
        "frame": options.frame,
        "crop_m": corners,
        "dropped_instances": dropped,
        "voxel_m": options.voxel,
        "points": options.points,
        "padding": options.padding,
    }


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("checkpoint")
    parser.add_argument("--cameras", required=True, help="names of the depth cameras, with commas between them")
    parser.add_argument("--out", required=True)
    parser.add_argument("--horizon", type=int, help="the file's, or 16")
    parser.add_argument("--n-action-steps", type=int, help="the file's, or 8")
    parser.add_argument("--points", type=int, default=1024, help="points of a cloud")
    parser.add_argument("--frame", choices=FRAMES, default=FRAMES[0], help="frame of the points")
    parser.add_argument("--crop", help="box outside of which points are dropped, m: X,Y,Z,X,Y,Z of its corners")
    parser.add_argument("--dropped-instances", default="", help="ids that are dropped, with commas between them")
    parser.add_argument("--voxel", type=float, help="side of the cubes of which each keeps its first point, m")
    parser.add_argument("--padding", choices=PADDINGS, default=PADDINGS[0], help="what fills a cloud that has fewer points; origin is what the authors do")
    recipe.add_options(parser)
    options = recipe.parsed(parser)
    if options.actions is None or options.recorded is None:
        common.fail("--actions and --recorded must be given: the file says neither, and a DP3 folder needs both")

    checkpoint = common.load_checkpoint(options.checkpoint)
    state = averaged(checkpoint)
    weights = {key: value for key, value in state.items() if not key.startswith(DROPPED)}
    cfg = common.plain(checkpoint.get("cfg", {}))
    network = network_of(weights, cfg if isinstance(cfg, dict) else {}, options)
    found = {feature: limits(state, name) for feature, name in FEATURES.items()}
    if len(found["observation.points"]["min"]) != 3:
        common.fail(f"the normaliser of the points has {len(found['observation.points']['min'])} numbers, expected 3")

    folder = common.new_folder(options.out)
    common.write_weights(folder, weights)
    flat = {f"{feature}.{part}": value for feature, parts in found.items() for part, value in parts.items()}
    kept = re.compile(r"(observation\.state|action)\.|observation\.points\.(min|max)$")
    save_file({key: value for key, value in flat.items() if kept.match(key)}, folder / "statistics.safetensors")
    common.write_json(folder / "config.json", {"type": "dp3", "network": network, "cloud": cloud_of(options)})
    cameras = [f"observation.images.{name}" for name in options.cameras.split(",")]
    variants = {"backbone_norm": "frozen_batch_norm", "loss_denominator": "valid"}
    preset = "dp3" if network["blocks"] == 2 else "simple_dp3"
    every = network["n_action_steps"]
    recipe.write(folder, options, options.checkpoint, preset, cameras, None, network["state_dim"], every, variants)
    print(f"{len(weights)} tensors of {preset}, horizon {network['horizon']}, in {folder}")


FEATURES = {"observation.state": "agent_pos", "action": "action", "observation.points": "point_cloud"}
FRAMES = ["scene", "first_camera"]
PADDINGS = ["origin", "first_point"]

if __name__ == "__main__":
    main()
