#!/usr/bin/env python3
"""Checkpoints and datasets, to LeRobot and back.

Requirements: Python 3.12, lerobot==0.6.1 torch==2.11.0 torchvision==0.26.0, and for datasets datasets<5 pandas<3 pyarrow av<16

    cargo build --locked --workspace
    python tests/scripts/lerobot_round_trip.py target/lerobot [--demos FOLDER]

Everything is made anew in the given folder: two demonstrations by `trocar record` (or those of --demos), two checkpoints that we
train on them for two steps, a checkpoint and two datasets that LeRobot saves. Our side of each comparison is the ignored test in
`policy/train/tests/peer.rs`, which this script starts. It prints how far the two sides are apart, and fails beyond the tolerances below.

  ours -> theirs   LeRobot loads what we trained (strictly: no key may be missing or left over), with its own processors, and
                   gives our chunk
  theirs -> ours   we load what `save_pretrained` wrote, random weights and random frozen statistics, and give its chunk
  trained there    two steps of LeRobot's own training on what we recorded, with its features, statistics and processors; with
                   `policy/convert/lerobot_recipe.py` the folder is then run by `trocar run`
  not theirs       a backbone with group normalisation, which LeRobot does not have: it must refuse it, not load it wrongly
  dataset ->       LeRobotDataset reads what we recorded: every number, image, time, task, and chunks by delta_timestamps; and frames
                   of what we recorded as video
  dataset <-       we read what LeRobotDataset recorded, as images and, where ffmpeg is installed, as video
"""

import argparse
import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

os.environ["HF_HUB_OFFLINE"] = "1"

import numpy as np
import torch
from safetensors.torch import load_file, save_file

from lerobot.configs.types import FeatureType, NormalizationMode, PolicyFeature
from lerobot.datasets.lerobot_dataset import LeRobotDataset
from lerobot.policies.act.configuration_act import ACTConfig
from lerobot.policies.act.modeling_act import ACTPolicy
from lerobot.policies.factory import make_pre_post_processors
from lerobot.utils.constants import IMAGENET_STATS
from lerobot.utils.feature_utils import dataset_to_policy_features

ROOT = Path(__file__).resolve().parents[2]
# Of the greatest number of a chunk, in SI units: single precision through a backbone that normalises nothing at the beginning.
CHUNK_TOLERANCE = 5e-6
# Of a channel of a decoded frame of video, of 255: two programs' conversions from YUV.
VIDEO_TOLERANCE = 3
NAMES = {"ours": "ours -> theirs", "theirs": "theirs -> ours", "trained": "trained there -> ours"}
failures = []


def report(what, found, tolerance):
    good = bool(found <= tolerance)
    print(f"{what:<64} {found:.3g} (at most {tolerance:.3g}){'' if good else '  FAILED'}", flush=True)
    if not good:
        failures.append(what)


def our_answers(work, jobs):
    file = work / "jobs.json"
    file.write_text(json.dumps(jobs, indent=1))
    command = ["cargo", "test", "--locked", "--workspace", "--test", "peer", "--", "--ignored"]
    subprocess.run(command, cwd=ROOT, env=os.environ | {"TROCAR_PEER": str(file)}, check=True)


def observation(config, batch, seed):
    """Random states near the statistics' middle, and images that are not flat."""
    generator = torch.Generator().manual_seed(seed)
    inputs = {"observation.state": torch.randn(batch, config.robot_state_feature.shape[0], generator=generator) * 0.3}
    for name, feature in config.image_features.items():
        _, height, width = feature.shape
        inputs[name] = torch.randint(0, 256, (batch, height, width, 3), generator=generator, dtype=torch.uint8)
    return inputs


def their_chunk(folder, inputs):
    policy = ACTPolicy.from_pretrained(folder, strict=True)
    policy.eval()
    before, after = make_pre_post_processors(policy.config, pretrained_path=str(folder))
    batch = {
        name: (value.permute(0, 3, 1, 2).float() / 255 if value.dtype == torch.uint8 else value.clone())
        for name, value in inputs.items()
    }
    with torch.inference_mode():
        return after(policy.predict_action_chunk(before(batch)))


def save_theirs(folder, cameras):
    """A policy as LeRobot saves it: random weights, frozen statistics that are not the neutral ones, statistics of a dataset."""
    torch.manual_seed(5)
    inputs = {f"observation.images.{name}": PolicyFeature(type=FeatureType.VISUAL, shape=(3, 96, 128)) for name in cameras}
    inputs["observation.state"] = PolicyFeature(type=FeatureType.STATE, shape=(7,))
    config = ACTConfig(
        input_features=inputs,
        output_features={"action": PolicyFeature(type=FeatureType.ACTION, shape=(7,))},
        pretrained_backbone_weights=None,
        device="cpu",
        push_to_hub=False,
        chunk_size=30,
        n_action_steps=30,
        dim_model=128,
        n_heads=4,
        dim_feedforward=256,
        n_decoder_layers=2,
    )
    assert all(mode is NormalizationMode.MEAN_STD for mode in config.normalization_mapping.values())
    policy = ACTPolicy(config)
    for name, buffer in policy.named_buffers():
        if "backbone" in name:
            buffer.copy_(torch.rand_like(buffer) * 0.5 + (0.75 if name.endswith(("weight", "running_var")) else -0.25))
    statistics = {
        "observation.state": {"mean": torch.randn(7) * 0.1, "std": torch.rand(7) + 0.2},
        "action": {"mean": torch.randn(7) * 0.01, "std": torch.rand(7) * 0.01 + 0.001},
    }
    for name in config.image_features:
        statistics[name] = {
            "mean": torch.tensor([0.485, 0.456, 0.406]).view(3, 1, 1),
            "std": torch.tensor([0.229, 0.224, 0.225]).view(3, 1, 1),
        }
    before, after = make_pre_post_processors(config, dataset_stats=statistics)
    policy.save_pretrained(folder)
    before.save_pretrained(folder)
    after.save_pretrained(folder)


def train_theirs(folder, demos):
    """As lerobot-train does it, but small and short: every feature of the dataset, ImageNet's statistics for images."""
    fps = json.loads((demos / "meta/info.json").read_text())["fps"]
    dataset = LeRobotDataset("local/demos", root=demos, delta_timestamps={"action": [step / fps for step in range(20)]})
    features = dataset_to_policy_features(dataset.meta.features)
    outputs = {name: feature for name, feature in features.items() if feature.type is FeatureType.ACTION}
    inputs = {name: feature for name, feature in features.items() if name not in outputs}
    sizes = {"dim_model": 64, "n_heads": 4, "dim_feedforward": 128, "n_encoder_layers": 1, "n_vae_encoder_layers": 1}
    config = ACTConfig(
        input_features=inputs,
        output_features=outputs,
        pretrained_backbone_weights=None,
        device="cpu",
        push_to_hub=False,
        chunk_size=20,
        n_action_steps=20,
        **sizes,
    )
    statistics = {name: dict(parts) for name, parts in dataset.meta.stats.items()}
    for name in dataset.meta.camera_keys:
        statistics[name] |= {part: torch.tensor(values) for part, values in IMAGENET_STATS.items()}
    torch.manual_seed(21)
    policy = ACTPolicy(config)
    before, after = make_pre_post_processors(config, dataset_stats=statistics)
    optimiser = torch.optim.AdamW(policy.get_optim_params(), lr=1e-4)
    policy.train()
    for batch, _ in zip(torch.utils.data.DataLoader(dataset, batch_size=2, shuffle=True), range(2)):
        loss, _ = policy.forward(before(batch))
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
    print(f"LeRobot trained for two steps, the loss is {loss.item():.3f}")
    policy.save_pretrained(folder)
    before.save_pretrained(folder)
    after.save_pretrained(folder)
    command = [sys.executable, ROOT / "policy/convert/lerobot_recipe.py", folder, "--actions", "absolute_pose", "--fps", str(fps)]
    # Two demonstrations have numbers that never change; LeRobot is compared with the same statistics.
    command += ["--least-deviation", "1e-6"]
    subprocess.run(command, check=True)


def run_theirs(work):
    """The untrained policy does not lift a needle; what counts is that it is loaded, asked and followed."""
    result = work / "run.json"
    command = [ROOT / "target/debug/trocar", "run", "--task", "needle-lift", "--lockstep", "--policy", work / "trained", "--json", result]
    done = subprocess.run(command, capture_output=True, text=True)
    if done.returncode not in (0, 1) or not result.exists():
        print(f"trocar run of LeRobot's policy: {done.returncode}: {done.stderr.strip()}  FAILED")
        failures.append("trocar run of LeRobot's policy")
        return
    print(f"trocar run of LeRobot's policy: {json.loads(result.read_text())['reason']}")


def compare_chunks(work, cameras):
    for name in NAMES:
        folder = work / name
        if name == "theirs":
            save_theirs(folder, cameras)
        config = ACTPolicy.from_pretrained(folder, strict=True).config
        inputs = observation(config, 3, 11)
        save_file(inputs, work / f"{name}_inputs.safetensors")
    our_answers(
        work,
        [
            {
                "do": "act",
                "checkpoint": str(work / name),
                "inputs": str(work / f"{name}_inputs.safetensors"),
                "output": str(work / f"{name}_chunk.safetensors"),
            }
            for name in NAMES
        ],
    )
    for name, what in NAMES.items():
        expected = their_chunk(work / name, load_file(work / f"{name}_inputs.safetensors"))
        found = load_file(work / f"{name}_chunk.safetensors")["action"]
        assert found.shape == expected.shape, (found.shape, expected.shape)
        scale = expected.abs().max()
        print(f"{name}: {tuple(found.shape)} numbers up to {scale:.4g}, difference {(found - expected).abs().max():.3g}")
        report(what + ", chunk, of its greatest", ((found - expected).abs().max() / scale).item(), CHUNK_TOLERANCE)


def must_refuse(folder):
    """Group normalisation has the same keys as a frozen batch normalisation but two: loaded anyway, it would answer nonsense."""
    try:
        ACTPolicy.from_pretrained(folder)
    except Exception as error:  # noqa: BLE001 whatever it is, its text must name the cause
        # The reason is behind the parser's own error.
        causes = [error, error.__cause__, error.__context__]
        reasons = [str(cause) for cause in causes if "vision_backbone" in str(cause)]
        print(f"{folder.name}: refused by LeRobot: {(reasons or [str(error)])[0][:160]}")
        if not reasons:
            failures.append(f"{folder}: refused, but not for its backbone")
        return
    print(f"{folder}: loaded by LeRobot  FAILED")
    failures.append(f"{folder} was loaded")


def compare_their_reading(demos, ours):
    """`ours` is what our reader gives."""
    dataset = LeRobotDataset("local/demos", root=demos)
    info = json.loads((demos / "meta/info.json").read_text())
    assert len(dataset) == info["total_frames"] and dataset.num_episodes == info["total_episodes"]
    worst = {"numbers": 0.0, "images": 0.0, "time, s": 0.0}
    cameras = dataset.meta.camera_keys
    start = 0
    for index in range(len(dataset)):
        item = dataset[index]
        if item["frame_index"] == 0:
            start = index
        for name in ("observation.state", "observation.tip_pose", "action"):
            # LeRobot hands out single precision, whatever is stored.
            difference = (item[name] - ours[name][index].float()).abs().max().item()
            worst["numbers"] = max(worst["numbers"], difference)
        worst["time, s"] = max(worst["time, s"], abs(item["timestamp"].item() - (index - start) / info["fps"]))
        assert item["task"] == dataset.meta.tasks.index[0], item["task"]
        if index % 10 == 0:
            for name in cameras:
                theirs = (item[name] * 255).round().permute(1, 2, 0)
                difference = (theirs - ours[name][index // 10].float()).abs().max().item()
                worst["images"] = max(worst["images"], difference)
    for what, found in worst.items():
        report(f"dataset -> LeRobot, {what}", found, 1e-6 if what == "time, s" else 0.0)
    compare_chunks_of(demos, dataset, ours, info["fps"])
    compare_statistics(dataset, ours)


def compare_chunks_of(demos, dataset, ours, fps):
    steps = 8
    deltas = {"action": [step / fps for step in range(steps)]}
    windows = LeRobotDataset("local/demos", root=demos, delta_timestamps=deltas)
    ends = list(ours["episode_start"][1:].tolist()) + [len(dataset)]
    worst = 0.0
    for end in ends:
        for index in (end - 20, end - 3):
            item = windows[index]
            rows = [min(index + step, end - 1) for step in range(steps)]
            worst = max(worst, (item["action"].double() - ours["action"][rows]).abs().max().item())
            assert item["action_is_pad"].tolist() == [index + step >= end for step in range(steps)]
    report("dataset -> LeRobot, chunks by delta_timestamps", worst, 0.0)
    batch = next(iter(torch.utils.data.DataLoader(windows, batch_size=4)))
    assert batch["action"].shape == (4, steps, ours["action"].shape[1])


def compare_statistics(dataset, ours):
    worst = 0.0
    for name in ("observation.state", "observation.tip_pose", "action"):
        values = ours[name].numpy()
        for part, expected in (("mean", values.mean(0)), ("std", values.std(0)), ("min", values.min(0)), ("max", values.max(0))):
            worst = max(worst, np.abs(dataset.meta.stats[name][part] - expected).max())
    report("dataset -> LeRobot, statistics", worst, 1e-7)


def save_their_dataset(folder, demos, video):
    """The first 40 frames of each episode at a quarter of their size, recorded anew by LeRobot."""
    shutil.rmtree(folder, ignore_errors=True)
    source = LeRobotDataset("local/demos", root=demos)
    features = {
        name: dict(feature)
        for name, feature in source.meta.features.items()
        if name in ("observation.state", "observation.tip_pose", "action") or name in source.meta.camera_keys
    }
    for name in source.meta.camera_keys:
        features[name] = {"dtype": "video" if video else "image", "shape": (128, 128, 3), "names": ["height", "width", "channels"]}
    made = LeRobotDataset.create(
        "local/theirs", source.meta.fps, features, root=folder, robot_type="dvrk_psm_sim", use_videos=video
    )
    for episode in range(source.num_episodes):
        first = int(source.meta.episodes[episode]["dataset_from_index"])
        for index in range(first, first + 40):
            item = source[index]
            frame = {name: item[name].numpy() for name in ("observation.state", "action")}
            frame["observation.tip_pose"] = item["observation.tip_pose"].double().numpy()
            for name in source.meta.camera_keys:
                image = (item[name] * 255).round().byte().permute(1, 2, 0)
                frame[name] = image.reshape(128, 4, 128, 4, 3).float().mean((1, 3)).round().byte().numpy()
            made.add_frame(frame | {"task": item["task"]})
        made.save_episode()
    made.finalize()


def compare_our_reading(work, demos):
    kinds = ["images"] + (["video"] if shutil.which("ffmpeg") else [])
    if len(kinds) == 1:
        print("ffmpeg is not installed: datasets with video are not compared")
    jobs = []
    for kind in kinds:
        save_their_dataset(work / f"their_{kind}", demos, kind == "video")
        jobs.append(
            {"do": "frames", "dataset": str(work / f"their_{kind}"), "image_stride": 1, "output": str(work / f"their_{kind}.safetensors")}
        )
    our_answers(work, jobs)
    for kind in kinds:
        ours = load_file(work / f"their_{kind}.safetensors")
        theirs = LeRobotDataset("local/theirs", root=work / f"their_{kind}", video_backend="pyav")
        assert len(theirs) == len(ours["action"])
        numbers, images = 0.0, 0.0
        for index in range(len(theirs)):
            item = theirs[index]
            for name in ("observation.state", "observation.tip_pose", "action"):
                numbers = max(numbers, (item[name].double() - ours[name][index]).abs().max().item())
            for name in theirs.meta.camera_keys:
                theirs_image = (item[name] * 255).round().permute(1, 2, 0)
                images = max(images, (theirs_image - ours[name][index].float()).abs().max().item())
        report(f"dataset <- LeRobot as {kind}, numbers", numbers, 0.0)
        report(f"dataset <- LeRobot as {kind}, frames (of 255)", images, VIDEO_TOLERANCE if kind == "video" else 0)


def compare_their_reading_of_video(work):
    """Two short episodes of ours as video: the first is not all of it, so that times count from the right place."""
    for codec in ("h264", "av1"):
        demos = work / f"our_{codec}"
        command = [ROOT / "target/debug/trocar", "record", "--task", "block-transfer", "--episodes", "2", "--video", codec, "--out", demos]
        subprocess.run(command, check=True)
        our_answers(work, [{"do": "frames", "dataset": str(demos), "image_stride": 9, "output": str(work / f"our_{codec}.safetensors")}])
        ours = load_file(work / f"our_{codec}.safetensors")
        theirs = LeRobotDataset("local/video", root=demos, video_backend="pyav")
        worst = {"frames (of 255)": 0.0, "numbers": 0.0}
        for index in range(0, len(theirs), 9):
            item = theirs[index]
            theirs_image = (item["observation.images.endoscope"] * 255).round().permute(1, 2, 0)
            difference = (theirs_image - ours["observation.images.endoscope"][index // 9].float()).abs().max().item()
            worst["frames (of 255)"] = max(worst["frames (of 255)"], difference)
            worst["numbers"] = max(worst["numbers"], (item["action"] - ours["action"][index].float()).abs().max().item())
        for what, found in worst.items():
            report(f"dataset -> LeRobot as {codec}, {what}", found, VIDEO_TOLERANCE if "255" in what else 0)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("work", type=Path)
    parser.add_argument("--demos", type=Path, help="a dataset of one arm instead of one that is recorded now")
    arguments = parser.parse_args()
    work = arguments.work.resolve()
    if work.exists() and not (work / "jobs.json").exists() and any(work.iterdir()):
        sys.exit(f"{work} is not empty and not of this script")
    shutil.rmtree(work, ignore_errors=True)
    work.mkdir(parents=True)
    (work / "jobs.json").write_text("[]")
    demos = work / "demos"
    if arguments.demos:
        demos = arguments.demos.resolve()
    else:
        command = [ROOT / "target/debug/trocar", "record", "--task", "needle-lift", "--episodes", "2", "--out", demos]
        subprocess.run(command, check=True)
    our_answers(
        work,
        [{"do": "frames", "dataset": str(demos), "image_stride": 10, "output": str(work / "demos.safetensors")}]
        + [
            {"do": "train", "dataset": str(demos), "backbone_norm": norm, "out": str(work / name)}
            for name, norm in (("ours", "frozen_batch_norm"), ("ours_group_norm", "group_norm"))
        ],
    )
    train_theirs(work / "trained", demos)
    compare_chunks(work, ["endoscope", "wrist_a"])
    run_theirs(work)
    must_refuse(work / "ours_group_norm")
    must_refuse(ROOT / "config/policies/needle-lift/act-compact")
    compare_their_reading(demos, load_file(work / "demos.safetensors"))
    if shutil.which("ffmpeg"):
        compare_their_reading_of_video(work)
    compare_our_reading(work, demos)
    if failures:
        sys.exit("FAILED: " + "; ".join(failures))
    print("all of it fits")


if __name__ == "__main__":
    main()
