#!/usr/bin/env python3
"""`trocar export open-h` and `trocar import lerobot` against Open-H-Embodiment's own validator and LeRobot 0.3.3.

Requirements: Python 3.10 to 3.12, ffmpeg, lerobot==0.3.3 'av<15' opencv-python-headless pandas tyro (a CPU suffices)

    cargo build --locked --workspace
    python tests/scripts/open_h.py target/open-h --validator OPEN_H/scripts/validation/validate_formatting.py
        --converter OPEN_H/scripts/conversion/dvrk_zarr_to_lerobot.py [--demos FOLDER ...]

OPEN_H is a checkout of open-h/open-h-embodiment (c64ed5e); none of its code is here. Two demonstrations of each task are recorded into the
given folder, or datasets that were recorded before are taken (--demos); needle lift is recorded with disturbances, all others by both eyes of
the endoscope, needle handover with attempts that fail for want of time. Of each:

  export      the validator must find no error, nor a warning
  load        LeRobotDataset 0.3.3 must give every row's state, action, instruction and task, and decode frames of every camera
  import      with the mapping open-h-dvrk: tip poses, jaws and actions as recorded, joints by inverse kinematics
  raw         the frames as JPEG and a table in a dVRK's folders, imported with the mapping dvrk-raw: the same again
  convert     such folders through Open-H-Embodiment's own converter, and what LeRobot wrote imported with open-h-dvrk: the same again, and
              each picture
  train       three steps of ACT on each imported dataset, of the first task alone (--train-all: of all)

That converter wants two arms, four cameras of two sizes and a multiple of 12 episodes, which LeRobot encodes together. So each
demonstration is cut into six; of one arm psm2 repeats psm1, and a camera that is not there shows what its neighbour does.

The script prints how far the two sides are apart, and fails beyond the tolerances below.
"""

import argparse
import csv
import json
import math
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

os.environ["HF_HUB_OFFLINE"] = "1"

import av
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
# What the converter says of each camera, width and height, and the cameras whose frames it may show instead.
CONVERTED_CAMERAS = {
    "endoscope.left": ((960, 540), ["endoscope.left"]),
    "endoscope.right": ((960, 540), ["endoscope.right", "endoscope.left"]),
    "wrist.right": ((640, 480), ["wrist.right"]),
    "wrist.left": ((640, 480), ["wrist.left", "wrist.right"]),
}
# How our cameras are called there.
HERE_TO_THERE = {
    "endoscope": "endoscope.left",
    "endoscope_right": "endoscope.right",
    "wrist_right": "wrist.right",
    "wrist_left": "wrist.left",
}
# The converter's batch_encoding_size: episodes beyond a multiple of it stay without video.
BATCH = 12
# Mean difference of a frame's colours after JPEG, AV1 and H.264, of 255.
PICTURE_TOLERANCE = 4
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
    """Two demonstrations, and those of the attempts that failed; None if none may."""
    wrists = "wrist_right,wrist_left" if task == "needle-handover" else "wrist"
    more = ["--disturb", 0.6, "--vary", "views,light"] if task == "needle-lift" else ["--stereo"]
    out, failed = work / f"demos-{task}", None
    if task == "needle-handover":
        failed = work / f"failed-{task}"
        more += ["--failures", failed, "--set", f"scene.episode.time_limit_s={between_two_attempts(work, task)}"]
    trocar("record", "--task", task, "--episodes", 2, "--source", "expert", "--cameras", f"endoscope,{wrists}", *more, "--out", out)
    return out, failed


def between_two_attempts(work, task):
    """A time limit that some attempts of the expert keep and some don't, s."""
    trials = work / f"trials-{task}.json"
    trocar("eval", "--task", task, "--policy", "expert", "--trials", 4, "--seed", 0, "--json", trials)
    seconds = sorted(episode["seconds"] for episode in json.loads(trials.read_text())["episodes"])
    return round((seconds[1] + seconds[2]) / 2, 2)


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


def write_raw(out, rows, names, frame_ns, cameras):
    """An episode as a dVRK's recorder leaves it: `cameras` has the frames' size, or None, and their feature by the camera's name."""
    for camera in cameras:
        (out / RAW_CAMERAS[camera][0]).mkdir(parents=True)
    with open(out / "ee_csv.csv", "w", newline="") as file:
        table = csv.writer(file)
        table.writerow(["timestamp", *names])
        for index, row in enumerate(rows):
            # float32 as Python prints its nearest double: nothing is lost.
            table.writerow([1_700_000_000_000_000_000 + index * frame_ns, *row["observation.state"].tolist(), *row["action"].tolist()])
            for camera, (size, feature) in cameras.items():
                place, ending = RAW_CAMERAS[camera]
                pixels = (row[feature].permute(1, 2, 0).numpy() * 255).round().astype(np.uint8)
                image = Image.fromarray(pixels)
                image = image.resize(size) if size else image
                image.save(out / f"{place}/frame{index:06d}_{ending}.jpg", quality=95)


def column_names(info):
    return [*info["features"]["observation.state"]["names"], *info["features"]["action"]["names"]]


def short(feature):
    return feature.removeprefix("observation.images.")


def raw_folders(folder, dataset, info, cameras):
    shown = {short(feature): (None, feature) for feature in cameras}
    for episode in range(info["total_episodes"]):
        start, end = (int(dataset.episode_data_index[side][episode]) for side in ("from", "to"))
        out = folder / f"tissue_1/1_subtask/episode_{episode:03d}"
        rows = (dataset[index] for index in range(start, end))
        write_raw(out, rows, column_names(info), 1_000_000_000 // info["fps"], shown)


def convertible_folders(folder, dataset, info, cameras):
    """Raw folders as the converter takes them: of tissue 10, with two arms, at 30 a second. The indices of each one's rows, by its name."""
    known = {short(feature): feature for feature in cameras}
    shown = {}
    for camera, (size, instead) in CONVERTED_CAMERAS.items():
        shown[camera] = (size, next(known[name] for name in instead if name in known))
    names, vectors = column_names(info), ["observation.state", "action"]
    copies = 2 if len(names) == 16 else 1
    if copies == 2:
        names = [name.replace("psm1", psm) for half in (names[:8], names[8:]) for psm in ("psm1", "psm2") for name in half]
    total, pieces = info["total_episodes"], {}
    for episode in range(total):
        start, end = (int(dataset.episode_data_index[side][episode]) for side in ("from", "to"))
        for part in np.array_split(np.arange(start, end), BATCH // math.gcd(BATCH, total)):
            name = f"episode_{len(pieces):03d}"
            pieces[name] = part
            rows = (row | {vector: row[vector].repeat(copies) for vector in vectors} for row in (dataset[int(index)] for index in part))
            write_raw(folder / name, rows, names, 1_000_000_000 // 30, shown)
    return pieces


def pictures_apart(imported, folder, pieces):
    """The greatest mean difference of a picture, of any camera, from the recorder's, and the means from its own and from that before."""
    features = json.loads((imported / "meta/info.json").read_text())["features"]
    own, before = [], []
    for feature in (name for name in features if name.startswith("observation.images.")):
        place, ending = RAW_CAMERAS[HERE_TO_THERE[short(feature)]]
        paths = [path for name in pieces for path in sorted((folder / name / place).glob(f"*_{ending}.jpg"))]
        videos = sorted(imported.glob(f"videos/{feature}/chunk-*/file-*.mp4"))
        frames = (frame for video in videos for frame in av.open(str(video)).decode(video=0))
        last = None, None
        for path, frame in zip(paths, frames, strict=True):
            image = frame.to_image()
            meant = Image.open(path).resize(image.size)
            meant, image = (np.asarray(it, dtype=np.float32) for it in (meant, image))
            own.append(np.abs(meant - image).mean())
            if last[0] == path.parent:
                before.append(np.abs(last[1] - image).mean())
            last = path.parent, meant
    return max(own), np.mean(own), np.mean(before)


def convert(converter, work, name, dataset, info, cameras, meant):
    folder, home = work / f"convertible-{name}", work / "lerobot"
    subtask = folder / "tissue_10/1_subtask"
    pieces = convertible_folders(subtask, dataset, info, cameras)
    command = [sys.executable, str(converter), "--data-path", str(folder), "--repo-id", f"local/{name}"]
    done = subprocess.run(command, env=os.environ | {"HF_LEROBOT_HOME": str(home)}, capture_output=True, text=True)
    if done.returncode or f"Total episodes processed: {len(pieces)}" not in done.stdout:
        sys.exit(f"{converter}: {done.stdout[-4000:]}{done.stderr[-4000:]}")
    # It takes folders as they come.
    pieces = {piece: pieces[piece] for piece in os.listdir(subtask)}
    out = work / f"converted-{name}"
    # ACT wants whole multiples of its own 256x256.
    form = ["--mapping", "open-h-dvrk", "--video", "h264", "--resize", "512x512"]
    trocar("import", "lerobot", home / f"local/{name}", *form, "--out", out)
    recorded = {key: np.concatenate([episode[key] for episode in meant]) for key in ("observation.state", "observation.tip_pose", "action")}
    copies = 2 * 7 // recorded["observation.state"].shape[1]
    compare(
        f"{name} -> raw folders -> converter -> back",
        ours(out),
        [{key: np.tile(values[rows], (1, copies)) for key, values in recorded.items()} for rows in pieces.values()],
    )
    greatest, own, before = pictures_apart(out, subtask, pieces)
    report(f"{name} -> raw folders -> converter -> back, pictures", greatest, PICTURE_TOLERANCE)
    report("  in the mean, beside that from the picture before", own, before)
    return out


def train(folder, out):
    trocar("train", "--policy", "act", "--preset", "small", "--data", folder, "--out", out, "--steps", 3, "--batch", 1, "--device", "cpu")


def judge(work, recording, validator, converter, with_training):
    demos, failed = recording
    name = demos.name
    recorded = ours(demos)
    meant = [recorded[index] for index in order(demos)]
    lost = ours(failed) if failed else []
    exported = work / f"open-h-{name}"
    trocar("export", "open-h", demos, *(["--failures", failed] if failed else []), "--out", exported)
    if validator:
        validate(validator, exported)
    dataset, info, cameras = load(exported, meant + lost)
    back = work / f"back-{name}"
    trocar("import", "lerobot", exported, "--mapping", "open-h-dvrk", "--video", "h264", "--out", back)
    compare(f"{name} -> open-h -> back", ours(back), meant)
    if failed:
        again = work / f"back-{failed.name}"
        trocar("import", "lerobot", exported, "--mapping", "open-h-dvrk", "--split", "failure", "--video", "h264", "--out", again)
        compare(f"{failed.name} -> open-h -> back", ours(again), lost)
    # Failures come last; what follows is of the others.
    info = info | {"total_episodes": len(meant)}
    raw_folders(work / f"raw-{name}", dataset, info, cameras)
    trocar("import", "lerobot", work / f"raw-{name}", "--mapping", "dvrk-raw", "--video", "h264", "--out", work / f"from-raw-{name}")
    compare(f"{name} -> raw folders -> back", ours(work / f"from-raw-{name}"), meant)
    imported = [back, work / f"from-raw-{name}"]
    if converter:
        imported.append(convert(converter, work, name, dataset, info, cameras, meant))
    for folder in imported if with_training else []:
        train(folder, work / f"act-{folder.name}")


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("work", type=Path)
    parser.add_argument("--validator", type=Path)
    parser.add_argument("--converter", type=Path)
    parser.add_argument("--demos", type=Path, nargs="*", default=[])
    parser.add_argument("--train-all", action="store_true")
    arguments = parser.parse_args()
    work = arguments.work.resolve()
    shutil.rmtree(work, ignore_errors=True)
    work.mkdir(parents=True)
    demos = [(folder.resolve(), None) for folder in arguments.demos] or [record(work, task) for task in TASKS]
    for index, recording in enumerate(demos):
        judge(work, recording, arguments.validator, arguments.converter, arguments.train_all or index == 0)
    if failures:
        sys.exit(f"{len(failures)} failed: {'; '.join(failures)}")
    print("all good")


if __name__ == "__main__":
    main()
