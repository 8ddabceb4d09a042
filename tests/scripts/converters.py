#!/usr/bin/env python3
"""The converters of `policy/convert/`, and `trocar import`, against the programs whose files they read.

Requirements: those of lerobot_round_trip.py, and einops diffusers omegaconf dill h5py

    cargo build --locked --workspace
    python tests/scripts/converters.py target/converters --act ACT_SOURCE --dp3 DP3_SOURCE [--demos FOLDER]

ACT_SOURCE and DP3_SOURCE are checkouts of tonyzhaozh/act (742c753) and YanjieZe/3D-Diffusion-Policy (47385d9); none of their code is
here. Each case builds the authors' own network with random weights, saves it as their training does, converts the file, and
compares what the authors' code answers to a random observation with what ours answers (the ignored test in `policy/train/tests/peer.rs`).

  act      seven decoder layers, two cameras, 14 numbers of state and action: two arms
  dp3      SimpleDP3 and, at a quarter of its width, DP3; in the file `model` and `ema_model` have different weights
  legacy   LeRobot's ACT with its statistics among the weights, as 0.3.3 wrote it
  hdf5     what `trocar record` recorded (now, or in --demos) put by h5py into ACT's and robomimic's layout, in every kind of
           storage that h5py has, and imported again: our reader and LeRobot's must find the same numbers and pictures, and the
           poses that the import computes must be the recorded; JPEG as Pillow decodes it, but for rounding

    python tests/scripts/converters.py target/converters --only hdf5 [--demos FOLDER]

Then files that must not be converted, with the reason that is given.
"""

import argparse
import io
import json
import os
import pickle
import shutil
import subprocess
import sys
import types
from pathlib import Path

os.environ["HF_HUB_OFFLINE"] = "1"

import numpy as np
import torch
from PIL import Image
from safetensors.torch import load_file, save_file

sys.path.insert(0, str(Path(__file__).parent))
from lerobot_round_trip import ROOT, failures, our_answers, report, save_theirs, their_chunk  # noqa: E402

CONVERT = ROOT / "policy/convert"
# Of the greatest number of an answer, in SI units.
TOLERANCE = 5e-6


def stub(name, **members):
    """A module that the authors import and that takes no part in inference."""
    module = types.ModuleType(name)
    for member, value in members.items():
        setattr(module, member, value)
    sys.modules[name] = module


def convert(script, *arguments):
    command = [sys.executable, str(CONVERT / script), *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True)


def converted(script, *arguments):
    done = convert(script, *arguments)
    if done.returncode:
        sys.exit(f"{script}: {done.stdout}{done.stderr}")
    print(f"{script}: {done.stdout.strip()}", flush=True)


def must_fail(what, reason, script, *arguments):
    judge_refusal(what, reason, convert(script, *arguments))


def judge_refusal(what, reason, done):
    text = (done.stdout + done.stderr).strip()
    if done.returncode == 0 or reason not in text or "Traceback" in text:
        print(f"{what}: expected {reason!r}, found: {text}  FAILED")
        failures.append(what)
    else:
        print(f"{what:<40} refused: {text.splitlines()[-1][:140]}")


def compare(what, expected, file):
    found = load_file(file)["action"]
    assert found.shape == expected.shape, (found.shape, expected.shape)
    scale = expected.abs().max()
    report(f"{what}, {tuple(found.shape)} up to {scale:.3g}, of its greatest", ((found - expected).abs().max() / scale).item(), TOLERANCE)


def shaken(module):
    """Random weights everywhere, normalisation layers and their statistics too, so that nothing is neutral."""
    with torch.no_grad():
        for name, tensor in module.state_dict().items():
            if not tensor.is_floating_point() or "pos_table" in name or "normalizer" in name:
                continue
            if name.endswith("running_var"):
                tensor.uniform_(0.5, 1.5)
            elif tensor.ndim == 1 and name.endswith("weight"):
                tensor.uniform_(0.8, 1.2)
            elif tensor.ndim == 1:
                tensor.uniform_(-0.1, 0.1)
    return module


def authors_act(source):
    """The original network, made without its optimiser, its GPU and its download."""
    stub("IPython", embed=None)
    sys.path[:0] = [str(source), str(source / "detr")]
    from detr.main import get_args_parser
    from detr.models import backbone, build_ACT_model

    backbone.is_main_process = lambda: False
    # The function reads the command line for things that it then overrides.
    parser = argparse.ArgumentParser(parents=[get_args_parser()])
    needed = "--ckpt_dir . --policy_class ACT --task_name none --seed 0 --num_epochs 1"
    args = parser.parse_args(needed.split())
    sizes = {"hidden_dim": 128, "dim_feedforward": 256, "enc_layers": 2, "dec_layers": 7, "nheads": 8, "num_queries": 20}
    for name, value in (sizes | {"camera_names": ["top", "side"], "lr_backbone": 1e-5, "backbone": "resnet18"}).items():
        setattr(args, name, value)
    torch.manual_seed(3)
    return shaken(build_ACT_model(args)).eval()


def act_case(work, source):
    model = authors_act(source)
    checkpoint, statistics = work / "policy_best.ckpt", work / "dataset_stats.pkl"
    torch.save({f"model.{key}": value for key, value in model.state_dict().items()}, checkpoint)
    generator = np.random.default_rng(4)
    numbers = {
        f"{name}_{part}": generator.uniform(0.01, 0.5, 14).astype(np.float32) for name in ("qpos", "action") for part in ("mean", "std")
    }
    with open(statistics, "wb") as file:
        pickle.dump(numbers | {"example_qpos": np.zeros((5, 14), np.float32)}, file)
    options = ["--cameras", "top,side", "--image", "128x96"]
    converted("act_ckpt.py", checkpoint, statistics, *options, "--out", work / "act", "--actions", "observation_relative", "--fps", 25)
    torch.manual_seed(6)
    images = torch.randint(0, 256, (2, 2, 96, 128, 3), dtype=torch.uint8)
    state = torch.randn(2, 14) * 0.3
    inputs = {"observation.state": state, "observation.images.top": images[:, 0].contiguous()}
    save_file(inputs | {"observation.images.side": images[:, 1].contiguous()}, work / "act_inputs.safetensors")
    mean, std = torch.tensor([0.485, 0.456, 0.406]).view(3, 1, 1), torch.tensor([0.229, 0.224, 0.225]).view(3, 1, 1)
    with torch.inference_mode():
        seen = (images.permute(0, 1, 4, 2, 3) / 255.0 - mean) / std
        of = {name: torch.from_numpy(values) for name, values in numbers.items()}
        chunk, _, _ = model((state - of["qpos_mean"]) / of["qpos_std"], seen, None)
    expected = chunk * of["action_std"] + of["action_mean"]
    refuse_act(work, checkpoint, statistics, numbers, options)
    return {"do": "act", "name": "act", "what": "original ACT"}, expected


def refuse_act(work, checkpoint, statistics, numbers, options):
    out = ["--out", work / "refused"]
    with open(work / "short.pkl", "wb") as file:
        pickle.dump({name: value for name, value in numbers.items() if name != "action_std"}, file)
    with open(work / "nan.pkl", "wb") as file:
        pickle.dump(numbers | {"qpos_mean": np.full(14, np.nan, np.float32)}, file)
    torch.save({"model.something": torch.zeros(3)}, work / "other.ckpt")
    must_fail("nobody says how fast", "--fps must be given", "act_ckpt.py", checkpoint, statistics, *options, *out, "--actions", "observation_relative")
    must_fail("statistics without a part", "has no action_std", "act_ckpt.py", checkpoint, work / "short.pkl", *options, *out)
    must_fail("statistics that are NaN", "not finite", "act_ckpt.py", checkpoint, work / "nan.pkl", *options, *out)
    must_fail("another network", "no place for the tensor", "act_ckpt.py", work / "other.ckpt", statistics, *options, *out)
    must_fail("a folder that is not empty", "not an empty folder", "act_ckpt.py", checkpoint, statistics, *options, "--out", work)

    class Harmful:
        def __reduce__(self):
            return (os.mkdir, (str(work / "harm"),))

    torch.save({"model.x": Harmful()}, work / "harmful.ckpt")
    convert("act_ckpt.py", work / "harmful.ckpt", statistics, *options, *out)
    if (work / "harm").exists():
        failures.append("a pickle's code was run")
    else:
        print("a pickle that would run code: nothing of it was run")


def authors_dp3(source, simple):
    """The authors' policy from their own configuration file's values."""
    from diffusers.schedulers.scheduling_ddim import DDIMScheduler
    from omegaconf import OmegaConf

    if simple:
        from diffusion_policy_3d.policy.simple_dp3 import SimpleDP3 as Policy
    else:
        from diffusion_policy_3d.policy.dp3 import DP3 as Policy
    name = "simple_dp3" if simple else "dp3"
    cfg = OmegaConf.load(source / f"3D-Diffusion-Policy/diffusion_policy_3d/config/{name}.yaml")
    cfg.shape_meta = {"obs": {"point_cloud": {"shape": [256, 3]}, "agent_pos": {"shape": [7]}}, "action": {"shape": [7]}}
    cfg.task = {"name": "lift"}
    if not simple:
        cfg.policy.down_dims = [128, 256, 512]
    policy = OmegaConf.to_container(cfg.policy, resolve=True)
    encoder = OmegaConf.create({"in_channels": 3, "out_channels": 64, "use_layernorm": True, "final_norm": "layernorm", "normal_channel": False})
    scheduler = dict(policy["noise_scheduler"])
    scheduler.pop("_target_")
    named = {
        "shape_meta": cfg.shape_meta,
        "noise_scheduler": DDIMScheduler(**scheduler),
        "horizon": cfg.horizon,
        "n_action_steps": cfg.n_action_steps,
        "n_obs_steps": cfg.n_obs_steps,
        "num_inference_steps": policy["num_inference_steps"],
        "pointcloud_encoder_cfg": encoder,
    }
    same = ("diffusion_step_embed_dim", "down_dims", "kernel_size", "n_groups", "condition_type", "encoder_output_dim")
    same += ("use_down_condition", "use_mid_condition", "use_up_condition", "use_pc_color", "pointnet_type")
    torch.manual_seed(8)
    return shaken(Policy(**named, **{key: policy[key] for key in same})).eval(), cfg


def dp3_case(work, source, simple):
    import dill
    from diffusion_policy_3d.model.common.normalizer import LinearNormalizer

    name = "simple_dp3" if simple else "dp3"
    policy, cfg = authors_dp3(source, simple)
    generator = torch.Generator().manual_seed(9)
    data = {
        "action": torch.rand(200, 7, generator=generator) * 0.02 - 0.01,
        "agent_pos": torch.rand(200, 7, generator=generator),
        "point_cloud": torch.rand(200, 256, 3, generator=generator) * 0.2,
    }
    # A joint that never moves is only shifted.
    data["agent_pos"][:, 3] = 0.25
    normalizer = LinearNormalizer()
    normalizer.fit(data, last_n_dims=1, mode="limits")
    policy.set_normalizer(normalizer)
    with torch.no_grad():
        # Random weights answer far beyond what is clipped; a clipped number shows nothing.
        policy.model.final_conv[-1].weight.mul_(0.05)
    state = policy.state_dict()
    other = {key: value + 0.5 if value.is_floating_point() and "normalizer" not in key else value for key, value in state.items()}
    payload = {"cfg": cfg, "state_dicts": {"model": other, "ema_model": state}, "pickles": {"global_step": dill.dumps(7)}}
    checkpoint = work / f"{name}.ckpt"
    torch.save(payload, checkpoint, pickle_module=dill)
    recorded = ["--cameras", "endoscope", "--recorded", "512x512", "--points", "256"]
    converted("dp3_ckpt.py", checkpoint, *recorded, "--out", work / name, "--actions", "observation_relative", "--fps", 25)
    inputs = {
        "point_cloud": torch.rand(1, 2, 256, 3, generator=generator) * 0.2,
        "agent_pos": torch.rand(1, 2, 7, generator=generator),
        "noise": torch.randn(1, 16, 7, generator=generator),
    }
    save_file(inputs, work / f"{name}_inputs.safetensors")
    drawn = torch.randn
    # Where the authors draw their noise: the only call of it in inference.
    torch.randn = lambda *_, **__: inputs["noise"].clone()
    try:
        with torch.inference_mode():
            expected = policy.predict_action({key: inputs[key] for key in ("point_cloud", "agent_pos")})["action_pred"]
    finally:
        torch.randn = drawn
    ends = torch.stack([data["action"].min(0).values, data["action"].max(0).values])
    clipped = ((expected - ends[0]).abs() < 1e-7) | ((expected - ends[1]).abs() < 1e-7)
    print(f"{name}: {clipped.float().mean():.0%} of the numbers are clipped")
    if clipped.float().mean() > 0.5:
        failures.append(f"{name}: too many clipped numbers to compare")
    if simple:
        refuse_dp3(work, payload, recorded, dill)
    return {"do": "dp3", "name": name, "what": "SimpleDP3" if simple else "DP3"}, expected


def refuse_dp3(work, payload, recorded, dill):
    state = payload["state_dicts"]["ema_model"]
    out = ["--out", work / "refused", "--actions", "observation_relative", "--fps", 25]
    key = "normalizer.params_dict.action.scale"

    def saved(name, state):
        torch.save(payload | {"state_dicts": {"model": state}}, work / name, pickle_module=dill)
        return work / name

    gaussian = saved("gaussian.ckpt", state | {key: state[key] * 1.5})
    colour = "obs_encoder.extractor.mlp.0.weight"
    coloured = saved("coloured.ckpt", state | {colour: torch.zeros(64, 6)})
    bare = saved("bare.ckpt", {k: v for k, v in state.items() if not k.startswith("normalizer")})
    must_fail("a normaliser that is not by limits", "not by limits", "dp3_ckpt.py", gaussian, *recorded, *out)
    must_fail("a cloud with colour", "colour", "dp3_ckpt.py", coloured, *recorded, *out)
    must_fail("no normaliser", "has no", "dp3_ckpt.py", bare, *recorded, *out)
    must_fail("nobody says what actions mean", "--actions", "dp3_ckpt.py", gaussian, *recorded, "--out", work / "refused")


def legacy_case(work):
    """What LeRobot saves today, put back into the form of 0.3.3."""
    new, old = work / "lerobot", work / "legacy_form"
    save_theirs(new, ["endoscope"])
    old.mkdir()
    weights = load_file(new / "model.safetensors")
    before = load_file(next(new.glob("policy_preprocessor_step_*.safetensors")))
    for key, value in before.items():
        feature, part = key.rsplit(".", 1)
        name = feature.replace(".", "_")
        for normaliser in ("normalize_inputs",) if feature != "action" else ("normalize_targets", "unnormalize_outputs"):
            weights[f"{normaliser}.buffer_{name}.{part}"] = value.clone()
    save_file(weights, old / "model.safetensors")
    shutil.copy(new / "config.json", old / "config.json")
    converted("legacy_lerobot.py", old, "--out", work / "legacy", "--actions", "observation_relative", "--fps", 25)
    torch.manual_seed(10)
    images = torch.randint(0, 256, (2, 96, 128, 3), dtype=torch.uint8)
    inputs = {"observation.state": torch.randn(2, 7) * 0.3, "observation.images.endoscope": images}
    save_file(inputs, work / "legacy_inputs.safetensors")
    must_fail("a folder that is not of the old form", "0.3.3 or older", "legacy_lerobot.py", new, "--out", work / "refused")
    save_file(weights | {"normalize_inputs.buffer_observation_images_endoscope.mean": torch.zeros(3, 1, 1)}, old / "model.safetensors")
    must_fail("images by their own statistics", "not ImageNet's", "legacy_lerobot.py", old, "--out", work / "refused")
    return {"do": "act", "name": "legacy", "what": "LeRobot 0.3.3"}, their_chunk(new, inputs)


def jpeg_rows(images):
    """As act-plus-plus has them: a row each, padded to the same length, red and blue swapped by an encoder that takes blue first."""
    rows = []
    for image in images:
        file = io.BytesIO()
        Image.fromarray(np.ascontiguousarray(image[..., ::-1])).save(file, "JPEG", quality=50)
        rows.append(np.frombuffer(file.getvalue(), np.uint8))
    longest = max(map(len, rows))
    return np.stack([np.pad(row, (0, longest - len(row))) for row in rows]), np.array([[len(row) for row in rows]])


# Of h5py, by the episode: the oldest and the newest form of a file, and each way to store a dataset.
STORAGE = [
    ("earliest", {}),
    ("earliest", {"chunks": True}),
    ("earliest", {"compression": "gzip", "shuffle": True}),
    ("earliest", {"compression": "lzf", "fletcher32": True}),
    ("latest", {"compression": "gzip"}),
    ("latest", {"compression": "lzf", "shuffle": True, "maxshape": True}),
]


def stored(file, name, values, options):
    """Images a chunk each as ACT has them, or as h5py chooses."""
    options = dict(options)
    if options.get("maxshape"):
        options["maxshape"] = (None, *values.shape[1:])
    if values.ndim == 4 and options and "chunks" not in options:
        options["chunks"] = (1, *values.shape[1:])
    file.create_dataset(name, data=values, **options).attrs["unit"] = "SI"


def write_hdf5(work, recorded):
    """The recorded episodes in both layouts, as many times as there are ways to store them; the action is the joints a step later."""
    import h5py

    starts = [*recorded["episode_start"].tolist(), len(recorded["action"])]
    for folder in ("act_hdf5", "act_jpeg"):
        (work / folder).mkdir()
    with h5py.File(work / "robomimic.hdf5", "w") as whole:
        whole.create_group("mask")["train"] = np.array([b"demo_0"])
        for episode, (start, end) in enumerate(zip(starts, starts[1:])):
            rows = slice(start, end)
            joints = recorded["observation.state"][rows].numpy()
            image = recorded["observation.images.endoscope"][rows].numpy()
            action = np.concatenate([joints[1:], joints[-1:]])
            for way, (libver, options) in enumerate(STORAGE):
                number = way * (len(starts) - 1) + episode
                with h5py.File(work / f"act_hdf5/episode_{number}.hdf5", "w", libver=libver) as file:
                    file.attrs["sim"] = True
                    stored(file, "observations/qpos", joints.astype(np.float64 if way % 2 else np.float32), options)
                    stored(file, "observations/images/endoscope", image, options)
                    stored(file, "action", action, options)
                demo = whole.create_group(f"data/demo_{number}")
                demo.attrs["num_samples"] = len(joints)
                stored(demo, "obs/joint_pos", joints, options)
                stored(demo, "obs/endoscope_image", image, options)
                stored(demo, "actions", recorded["action"][rows].numpy(), options)
            with h5py.File(work / f"act_jpeg/episode_{episode}.hdf5", "w") as file:
                file.attrs["compress"] = True
                file["observations/qpos"], file["action"] = joints, action
                file["observations/images/endoscope"], file["compress_len"] = jpeg_rows(image)


def imported(*arguments):
    done = run_import(*arguments)
    if done.returncode:
        sys.exit(f"trocar import: {done.stdout}{done.stderr}")
    print(f"trocar import: {done.stdout.strip()}", flush=True)


def run_import(*arguments):
    command = [str(ROOT / "target/debug/trocar"), "import", *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True)


def import_must_fail(what, reason, *arguments):
    judge_refusal(what, reason, run_import(*arguments))


def hdf5_case(work, demos):
    from lerobot.datasets.lerobot_dataset import LeRobotDataset

    def dumped(dataset, name):
        job = {"do": "frames", "dataset": str(dataset), "image_stride": 1, "output": str(work / f"{name}.safetensors")}
        our_answers(work, [job])
        return load_file(work / f"{name}.safetensors")

    recorded = dumped(demos, "recorded")
    write_hdf5(work, recorded)
    same = ["--fps", 25, "--task", "Lift the needle", "--out"]
    names = ["--joints", "obs/joint_pos", "--images", "obs/endoscope_image", "--action-pose", "actions"]
    imported("act", work / "act_hdf5", *same, work / "from_act")
    imported("robomimic", work / "robomimic.hdf5", *names, *same, work / "from_robomimic")
    frames = len(recorded["action"])
    for name in ("from_act", "from_robomimic"):
        ours = dumped(work / name, name)
        assert len(ours["action"]) == frames * len(STORAGE), len(ours["action"])
        for way, (libver, options) in enumerate(STORAGE):
            part = {key: values[way * frames : (way + 1) * frames] for key, values in ours.items()}
            told = f"{name}, {libver} {' '.join(str(value) for value in options.values()) or 'contiguous'}"
            for feature in ("observation.state", "observation.images.endoscope"):
                difference = (part[feature].double() - recorded[feature].double()).abs().max().item()
                report(f"{told}, {feature}", difference, 0.0)
            report(f"{told}, tip poses by forward kinematics", pose_difference(part, recorded, "observation.tip_pose"), 2e-7)
            if name == "from_robomimic":
                report(f"{told}, actions", pose_difference(part, recorded, "action"), 0.0)
        theirs = LeRobotDataset(f"local/{name}", root=work / name)
        assert len(theirs) == frames * len(STORAGE) and theirs[0]["task"] == "Lift the needle"
        difference = max((theirs[index]["action"] - ours["action"][index].float()).abs().max().item() for index in range(0, len(theirs), 7))
        report(f"{name} -> LeRobot, actions", difference, 0.0)
    imported("act", work / "act_jpeg", *same, work / "from_jpeg")
    images = dumped(work / "from_jpeg", "from_jpeg")["observation.images.endoscope"]
    decoded = [np.asarray(Image.open(io.BytesIO(row.tobytes())))[..., ::-1] for row in jpeg_rows(recorded["observation.images.endoscope"].numpy())[0]]
    # Two decoders round differently, most where they enlarge colour.
    difference = (images.double() - torch.from_numpy(np.stack(decoded)).double()).abs()
    report("JPEG, of 255, mean difference to Pillow", difference.mean().item(), 0.2)
    report("JPEG, of 255, greatest difference to Pillow", difference.max().item(), 8.0)
    refuse_hdf5(work, same)


def pose_difference(ours, recorded, feature):
    """A quaternion and its negative are the same turn."""
    a, b = ours[feature], recorded[feature]
    sign = torch.sign((a[:, 3:7] * b[:, 3:7]).sum(1, keepdim=True))
    turned = (a[:, 3:7] * sign - b[:, 3:7]).abs().max()
    return max((a[:, :3] - b[:, :3]).abs().max().item(), turned.item())


def refuse_hdf5(work, same):
    import h5py

    cases = {
        "degrees": ("observations/qpos", lambda joints: np.degrees(joints), "outside"),
        "nan": ("observations/qpos", lambda joints: np.where(np.arange(7) == 2, np.nan, joints), "not finite"),
        "joints": ("observations/qpos", lambda joints: joints[:, :6], "expected 7"),
        "frames": ("observations/images/endoscope", lambda images: images[:-1], "frames of"),
        "sizes": ("observations/images/endoscope", lambda images: images[:, ::2], "the first episode"),
    }
    for name, (path, change, reason) in cases.items():
        folder = work / f"bad_{name}"
        folder.mkdir()
        for episode in ("episode_0.hdf5", "episode_1.hdf5"):
            shutil.copy(work / "act_hdf5" / episode, folder / episode)
        with h5py.File(folder / "episode_0.hdf5", "r+") as file:
            other = change(file[path][:])
            del file[path]
            file[path] = other
        import_must_fail(f"hdf5 with other {name}", reason, "act", folder, *same, work / f"refused_{name}")
    with h5py.File(work / "robomimic.hdf5", "r+") as file:
        file["data/demo_0/actions"][3] *= 0.1
    names = ["--joints", "obs/joint_pos", "--images", "obs/endoscope_image", "--action-pose", "actions"]
    import_must_fail("hdf5 with deltas", "deltas", "robomimic", work / "robomimic.hdf5", *names, *same, work / "refused_deltas")


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("work", type=Path)
    parser.add_argument("--act", type=Path)
    parser.add_argument("--dp3", type=Path)
    parser.add_argument("--only", choices=["hdf5"], help="this case alone, which needs neither source")
    parser.add_argument("--demos", type=Path, help="a dataset of one arm and the camera endoscope instead of one that is recorded now")
    options = parser.parse_args()
    if not options.only and not (options.act and options.dp3):
        parser.error("--act and --dp3, or --only hdf5")
    work = options.work.resolve()
    if work.exists() and not (work / "jobs.json").exists() and any(work.iterdir()):
        sys.exit(f"{work} is not empty and not of this script")
    shutil.rmtree(work, ignore_errors=True)
    work.mkdir(parents=True)
    (work / "jobs.json").write_text("[]")
    demos = work / "demos"
    if options.demos:
        demos = options.demos.resolve()
    else:
        command = [ROOT / "target/debug/trocar", "record", "--task", "needle-lift", "--episodes", "1", "--out", demos]
        subprocess.run(command, check=True)
    hdf5_case(work, demos)
    if not options.only:
        network_cases(work, options)
    if failures:
        sys.exit("FAILED: " + "; ".join(failures))
    print("all of it fits")


def network_cases(work, options):
    for name in ("pytorch3d", "zarr"):
        stub(name)
    stub("pytorch3d.ops")
    sys.modules["zarr"].Array = type("Array", (), {})
    sys.path.insert(0, str(options.dp3.resolve() / "3D-Diffusion-Policy"))
    cases = [act_case(work, options.act.resolve()), legacy_case(work)]
    cases += [dp3_case(work, options.dp3.resolve(), simple) for simple in (True, False)]
    jobs = []
    for job, _ in cases:
        name = job["name"]
        paths = {"checkpoint": work / name, "inputs": work / f"{name}_inputs.safetensors", "output": work / f"{name}_ours.safetensors"}
        jobs.append({"do": job["do"]} | {key: str(path) for key, path in paths.items()})
    our_answers(work, jobs)
    for job, expected in cases:
        compare(job["what"], expected, work / f"{job['name']}_ours.safetensors")


if __name__ == "__main__":
    main()
