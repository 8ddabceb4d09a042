#!/usr/bin/env python3
"""The original ACT's `.ckpt` and `dataset_stats.pkl` into a checkpoint's folder. Once, offline.

Requirements: torch numpy safetensors

    python policy/convert/act_ckpt.py policy_best.ckpt dataset_stats.pkl --cameras endoscope --image 640x480 --out runs/act \
        --actions observation_relative --fps 50

Nothing in the two files is run: whatever is no tensor or array is left unread. Sizes come from the weights; the size of the images,
the cameras' names in their order, and the number of heads (8) are not in them. Of the seven decoder layers the original uses the
first one's output, so that one is kept (LeRobot's n_decoder_layers = 1), as are the variational encoder's weights.

The original has no meaning of its actions; those of this project are relative to the tip (see --actions). Nor is its rate in the file: the
authors' tasks have 50 steps a second (--fps). A policy that predicts
joint angles can be converted and computed with, but not run on an arm.
"""

import argparse
import re

import common
import recipe

# The original's beginnings of keys, and LeRobot's. The first that fits wins.
NAMES = [
    ("transformer.encoder.", "encoder."),
    ("transformer.decoder.", "decoder."),
    ("encoder_action_proj.", "vae_encoder_action_input_proj."),
    ("encoder_joint_proj.", "vae_encoder_robot_state_input_proj."),
    ("encoder.", "vae_encoder."),
    ("backbones.0.0.body.", "backbone."),
    ("pos_table", "vae_encoder_pos_enc"),
    ("action_head.", "action_head."),
    ("input_proj.", "encoder_img_feat_input_proj."),
    ("input_proj_robot_state.", "encoder_robot_state_input_proj."),
    ("query_embed.", "decoder_pos_embed."),
    ("latent_out_proj.", "encoder_latent_input_proj."),
    ("additional_pos_embed.", "encoder_1d_feature_pos_embed."),
    ("cls_embed.", "vae_encoder_cls_embed."),
    ("latent_proj.", "vae_encoder_latent_output_proj."),
]
# Computed but in no loss, and decoder layers whose output nobody looks at.
DROPPED = re.compile(r"is_pad_head\.|transformer\.decoder\.layers\.[1-9]\d*\.|.*num_batches_tracked$")


def renamed(state):
    weights = {}
    for key, tensor in state.items():
        key = key.removeprefix("model.")
        if DROPPED.match(key):
            continue
        for theirs, ours in NAMES:
            if key.startswith(theirs):
                weights["model." + ours + key[len(theirs) :]] = tensor
                break
        else:
            common.fail(f"no place for the tensor {key}: this is no ACT checkpoint of the original code")
    return weights


def layers(weights, prefix):
    numbers = [int(key[len(prefix) :].split(".")[0]) for key in weights if key.startswith(prefix)]
    return max(numbers, default=-1) + 1


def config_of(weights, inputs, outputs, heads):
    shape = lambda key: tuple(weights["model." + key].shape)
    try:
        chunk, width = shape("decoder_pos_embed.weight")
        feedforward = shape("encoder.layers.0.linear1.weight")[0]
        latent = shape("encoder_latent_input_proj.weight")[1]
    except KeyError as error:
        common.fail(f"tensor {error} is missing: this is no ACT checkpoint of the original code")
    return {
        "type": "act",
        "n_obs_steps": 1,
        "input_features": inputs,
        "output_features": outputs,
        "device": "cpu",
        "use_amp": False,
        "push_to_hub": False,
        "chunk_size": chunk,
        "n_action_steps": chunk,
        "normalization_mapping": {"VISUAL": "MEAN_STD", "STATE": "MEAN_STD", "ACTION": "MEAN_STD"},
        "vision_backbone": "resnet18",
        "pretrained_backbone_weights": None,
        "replace_final_stride_with_dilation": 0,
        # Only then do the encoders have a norm at their end.
        "pre_norm": "model.encoder.norm.weight" in weights,
        "dim_model": width,
        "n_heads": heads,
        "dim_feedforward": feedforward,
        "feedforward_activation": "relu",
        "n_encoder_layers": layers(weights, "model.encoder.layers."),
        "n_decoder_layers": 1,
        "use_vae": True,
        "latent_dim": latent,
        "n_vae_encoder_layers": layers(weights, "model.vae_encoder.layers."),
        "temporal_ensemble_coeff": None,
        "dropout": 0.1,
        "kl_weight": 10.0,
        "optimizer_lr": 1e-5,
        "optimizer_weight_decay": 1e-4,
        "optimizer_lr_backbone": 1e-5,
    }


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("checkpoint")
    parser.add_argument("statistics", help="dataset_stats.pkl beside it")
    parser.add_argument("--cameras", required=True, help="names in the order of the training, with commas between them")
    parser.add_argument("--image", required=True, metavar="WIDTHxHEIGHT", help="size of the images that the network was trained on")
    parser.add_argument("--heads", type=int, default=8)
    parser.add_argument("--out", required=True)
    recipe.add_options(parser)
    options = recipe.parsed(parser)

    weights = renamed(common.load_checkpoint(options.checkpoint))
    found = common.load_pickle(options.statistics)
    state_dim = weights["model.encoder_robot_state_input_proj.weight"].shape[1]
    action_dim = weights["model.action_head.weight"].shape[0]
    statistics = {}
    for feature, name, width in (("observation.state", "qpos", state_dim), ("action", "action", action_dim)):
        missing = [part for part in ("mean", "std") if f"{name}_{part}" not in found]
        if missing:
            common.fail(f"{options.statistics} has no {name}_{missing[0]}")
        statistics[feature] = {part: common.vector(f"{name}_{part}", found[f"{name}_{part}"], width) for part in ("mean", "std")}
    cameras = [f"observation.images.{name}" for name in options.cameras.split(",")]
    width, height = recipe.size_of(options.image, "--image")
    inputs, outputs = common.act_features(cameras, height, width, state_dim, action_dim)
    config = config_of(weights, inputs, outputs, options.heads)

    folder = common.new_folder(options.out)
    common.write_weights(folder, weights)
    common.write_processors(folder, inputs, outputs, statistics)
    common.write_json(folder / "config.json", config)
    variants = {"backbone_norm": "frozen_batch_norm", "loss_denominator": "all"}
    size = (width, height)
    every = max(1, config["chunk_size"] // 2)
    recipe.write(folder, options, options.checkpoint, "paper", cameras, size, state_dim, every, variants)
    print(f"{len(weights)} tensors, chunks of {config['chunk_size']} steps, {state_dim} numbers of state, in {folder}")


if __name__ == "__main__":
    main()
