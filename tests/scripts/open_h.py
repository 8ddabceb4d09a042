#!/usr/bin/env python3
"""`trocar export open-h` and `trocar import lerobot` against Open-H-Embodiment's own validator and LeRobot 0.3.3.

Requirements: Python 3.10 or 3.11, ffmpeg, lerobot==0.3.3 opencv-python-headless pandas (a CPU suffices)

    cargo build --locked --workspace
    python tests/scripts/open_h.py target/open-h --validator OPEN_H/scripts/validation/validate_formatting.py [--demos FOLDER ...]

OPEN_H is a checkout of open-h/open-h-embodiment (c64ed5e); none of its code is here. Two demonstrations of each task are recorded into the
given folder, or datasets that were recorded before are taken (--demos); needle lift is recorded with disturbances. Of each:

  export      the validator must find no error, nor a warning
  load        LeRobotDataset 0.3.3 must give every row's state, action, instruction and task, and decode frames of every camera
  import      with the mapping open-h-dvrk: tip poses, jaws and actions as recorded, joints by inverse kinematics
  raw         the frames as JPEG and a table in a dVRK's folders, imported with the mapping dvrk-raw: the same again
  train       three steps of ACT on the imported dataset, of the first task alone (--train-all: of all)

The script prints how far the two sides are apart, and fails beyond the tolerances below.
"""

import argparse
import csv
import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

os.environ["HF_HUB_OFFLINE"] = "1"

import numpy as np
import pyarrow.parquet as parquet
from lerobot.datasets.lerobot_dataset import LeRobotDataset
from PIL import Image

ROOT = Path(__file__).resolve().parents[2]
TROCAR = os.environ.get("TROCAR", str(ROOT / "target/debug/trocar"))
TASKS = ["needle-lift", "needle-handover", "tissue-retraction", "suture-pad", "block-transfer"]
# Numbers are stored as float32: m, quaternion, rad.
POSE_TOLERANCE = 2e-7
# What that rounding makes of joints, rad (m): most near a straight wrist.
JOINT_TOLERANCE = 2e-5
RAW_CAMERAS = {
    "endoscope.left": ("left_img_dir", "left"),
    "endoscope.right": ("right_img_dir", "right"),
    "wrist.right": ("endo_psm1", "psm1"),
    "wrist.left": ("endo_psm2", "psm2"),
}
failures = []


def report(what, found, tolerance):
    good = bool(found <= tolerance)
    print(f"{what:<64} {found:.3g} (at most {tolerance:.3g}){'' if good else '  FAILED'}", flush=True)
    if not good:
        failures.append(what)


def trocar(*arguments):
    done = subprocess.run([TROCAR, *map(str, arguments)], capture_output=True, text=True)
    if done.returncode:
        sys.exit(f"trocar {' '.join(map(str, arguments))}: {done.stdout}{done.stderr}")
    print(f"trocar {arguments[0]}: {(done.stdout.strip().splitlines() or [''])[0]}", flush=True)


def record(work, task):
    wrists = "wrist_right,wrist_left" if task == "needle-handover" else "wrist"
    more = ["--disturb", 0.6, "--vary", "views,light"] if task == "needle-lift" else []
    out = work / f"demos-{task}"
    trocar("record", "--task", task, "--episodes", 2, "--source", "expert", "--cameras", f"endoscope,{wrists}", *more, "--out", out)
    return out


def ours(folder):
    """The numbers of a v3 dataset of ours by episode."""
    episodes = []
    for path in sorted(folder.glob("data/chunk-*/file-*.parquet")):
        columns = ["observation.state", "observation.tip_pose", "action", "episode_index"]
        table = parquet.read_table(path, columns=columns).to_pydict()
        rows = {name: np.array(values, dtype=np.float64) for name, values in table.items()}
        for index in np.unique(rows["episode_index"]):
            episodes.append({name: values[rows["episode_index"] == index] for name, values in rows.items()})
    return episodes


def order(folder):
    """The recorded episodes in the order of the export: those with a disturbance last."""
    path = folder / "meta/trocar_episodes.jsonl"
    notes = [json.loads(line) for line in path.read_text().splitlines()] if path.exists() else []
    disturbed = {note["episode_index"] for note in notes if note.get("disturbances")}
    episodes = range(json.loads((folder / "meta/info.json").read_text())["total_episodes"])
    return [index for index in episodes if index not in disturbed] + [index for index in episodes if index in disturbed]


def poses_apart(found, meant, width):
    """The greatest difference of poses, `width` numbers an arm; of a turn's two quaternions either."""
    found, meant = found.reshape(-1, width), meant.reshape(-1, width)
    side = np.sign((found[:, 3:7] * meant[:, 3:7]).sum(axis=1, keepdims=True))
    turned = np.concatenate([found[:, :3], found[:, 3:7] * side, found[:, 7:]], axis=1)
    return np.abs(turned - meant).max()


def compare(what, found, meant):
    assert len(found) == len(meant), (len(found), len(meant))
    for name, apart, tolerance in [
        ("observation.tip_pose", lambda a, b: poses_apart(a, b, 7), POSE_TOLERANCE),
        ("action", lambda a, b: poses_apart(a, b, 8), POSE_TOLERANCE),
        ("observation.state", lambda a, b: np.abs(a - b).max(), JOINT_TOLERANCE),
    ]:
        report(f"{what}, {name}", max(apart(a[name], b[name]) for a, b in zip(found, meant)), tolerance)


def validate(validator, folder):
    done = subprocess.run([sys.executable, str(validator), str(folder)], capture_output=True, text=True)
    counts = {name: int(count) for name, count in re.findall(r"(Success|Warnings|Errors): (\d+)", done.stdout)}
    told = f"{folder.name}, validator: {counts.get('Success')} passed,"
    report(f"{told} errors", counts.get("Errors", 999) + 999 * (done.returncode != 0), 0)
    report(f"{told} warnings", counts.get("Warnings", 999), 0)
    if "READY" not in done.stdout or counts.get("Warnings"):
        print(done.stdout[-4000:], done.stderr[-2000:])


def load(folder, meant):
    """LeRobot's view of the exported dataset, and whether it has what was recorded."""
    dataset = LeRobotDataset(f"local/{folder.name}", root=folder, video_backend="pyav")
    rows = dataset.hf_dataset.with_format("numpy")
    assert len(dataset) == sum(len(episode["action"]) for episode in meant)
    arms = meant[0]["action"].shape[1] // 8
    for name, width in [("observation.tip_pose", 7), ("observation.state", 7)]:
        assert meant[0][name].shape[1] == arms * width
    state = np.stack(rows["observation.state"]).astype(np.float64).reshape(len(dataset), arms, 8)
    recorded = {name: np.concatenate([episode[name] for episode in meant]) for name in meant[0]}
    tips = recorded["observation.tip_pose"].reshape(-1, arms, 7)
    joints = recorded["observation.state"].reshape(-1, arms, 7)
    report(f"{folder.name} -> LeRobot, tip poses", np.abs(state[..., :7] - tips).max(), POSE_TOLERANCE)
    report(f"{folder.name} -> LeRobot, jaws", np.abs(state[..., 7] - joints[..., 6]).max(), 0)
    action = np.stack(rows["action"]).astype(np.float64)
    report(f"{folder.name} -> LeRobot, actions", np.abs(action - recorded["action"]).max(), 0)
    info = json.loads((folder / "meta/info.json").read_text())
    cameras = [name for name in info["features"] if name.startswith("observation.images.")]
    for index in (0, len(dataset) // 2, len(dataset) - 1):
        row = dataset[index]
        assert row["task"] == row["instruction.text"], row["task"]
        assert row["observation.meta.tool.psm1"] == "Large Needle Driver"
        for camera in cameras:
            assert tuple(row[camera].shape) == (3, 512, 512) and row[camera].std() > 0.01, camera
    return dataset, info, cameras


def write_raw(folder, dataset, info, cameras):
    """The dataset as a dVRK's recorder leaves it."""
    names = [*info["features"]["observation.state"]["names"], *info["features"]["action"]["names"]]
    frame_ns = 1_000_000_000 // info["fps"]
    for episode in range(info["total_episodes"]):
        start, end = (int(dataset.episode_data_index[side][episode]) for side in ("from", "to"))
        out = folder / f"tissue_1/1_subtask/episode_{episode:03d}"
        for camera in cameras:
            (out / RAW_CAMERAS[camera.removeprefix("observation.images.")][0]).mkdir(parents=True)
        with open(out / "ee_csv.csv", "w", newline="") as file:
            table = csv.writer(file)
            table.writerow(["timestamp", *names])
            for index in range(start, end):
                row = dataset[index]
                # float32 as Python prints its nearest double: nothing is lost.
                numbers = [*row["observation.state"].tolist(), *row["action"].tolist()]
                table.writerow([1_700_000_000_000_000_000 + (index - start) * frame_ns, *numbers])
                for camera in cameras:
                    place, ending = RAW_CAMERAS[camera.removeprefix("observation.images.")]
                    pixels = (row[camera].permute(1, 2, 0).numpy() * 255).round().astype(np.uint8)
                    Image.fromarray(pixels).save(out / f"{place}/frame{index - start:06d}_{ending}.jpg", quality=95)


def train(folder, out):
    trocar("train", "--policy", "act", "--preset", "small", "--data", folder, "--out", out, "--steps", 3, "--batch", 1, "--device", "cpu")


def judge(work, demos, validator, with_training):
    name = demos.name
    recorded = ours(demos)
    meant = [recorded[index] for index in order(demos)]
    exported = work / f"open-h-{name}"
    trocar("export", "open-h", demos, "--out", exported)
    if validator:
        validate(validator, exported)
    dataset, info, cameras = load(exported, meant)
    trocar("import", "lerobot", exported, "--mapping", "open-h-dvrk", "--video", "h264", "--out", work / f"back-{name}")
    compare(f"{name} -> open-h -> back", ours(work / f"back-{name}"), meant)
    write_raw(work / f"raw-{name}", dataset, info, cameras)
    trocar("import", "lerobot", work / f"raw-{name}", "--mapping", "dvrk-raw", "--video", "h264", "--out", work / f"from-raw-{name}")
    compare(f"{name} -> raw folders -> back", ours(work / f"from-raw-{name}"), meant)
    if with_training:
        train(work / f"back-{name}", work / f"act-{name}")
        train(work / f"from-raw-{name}", work / f"act-raw-{name}")


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("work", type=Path)
    parser.add_argument("--validator", type=Path)
    parser.add_argument("--demos", type=Path, nargs="*", default=[])
    parser.add_argument("--train-all", action="store_true")
    arguments = parser.parse_args()
    work = arguments.work.resolve()
    shutil.rmtree(work, ignore_errors=True)
    work.mkdir(parents=True)
    demos = [folder.resolve() for folder in arguments.demos] or [record(work, task) for task in TASKS]
    for index, folder in enumerate(demos):
        judge(work, folder, arguments.validator, arguments.train_all or index == 0)
    if failures:
        sys.exit(f"{len(failures)} failed: {'; '.join(failures)}")
    print("all good")


if __name__ == "__main__":
    main()
