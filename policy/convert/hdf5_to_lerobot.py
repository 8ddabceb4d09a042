#!/usr/bin/env python3
"""HDF5 demonstrations of a dVRK arm or two, in ACT's or robomimic's layout, into a LeRobot v3 dataset that `trocar train` reads. Once,
offline.

Requirements: h5py numpy pyarrow pillow

    python policy/convert/hdf5_to_lerobot.py act FOLDER --fps 25 --task "Lift the needle" --out runs/demos
    python policy/convert/hdf5_to_lerobot.py robomimic FILE.hdf5 --fps 25 --task "Lift the needle" --out runs/demos \
        --joints obs/joint_pos --images obs/endoscope --action-pose actions

act        FOLDER/episode_0.hdf5 ...: observations/qpos and action (T, 7 an arm): six joint positions (rad, insertion m) and the jaw
           (rad); observations/images/CAMERA (T, height, width, 3), or JPEG of `compress_len` bytes each as in act-plus-plus
robomimic  FILE/data/demo_0 ...: joints and jaw by --joints as above, images by --images (several with commas between them); the action
           by --action-joints, or by --action-pose: position (m), quaternion (x, y, z, w) in the arm's RCM frame, jaw (rad): 8 an arm

A dataset here has for each frame the arm's joints, the pose of its tip, and the commanded pose of its tip. Poses that the file lacks
are computed from the joints by the arm's forward kinematics (--dh, or the patient-side manipulator with a Large Needle Driver as in
`hal/src/psm.rs`). What cannot be told from the file is refused rather than guessed: deltas as actions, another number of joints,
numbers that are not finite, joints outside of the arm's limits (degrees, or a normalised gripper), frames that are missing.
"""

import argparse
import io
import json
from pathlib import Path

import h5py
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from PIL import Image

QUARTER = np.pi / 2
# Modified Denavit-Hartenberg rows: twist (rad), length (m), offset along (m) and about (rad) the axis, whether the joint slides.
DH = [
    (QUARTER, 0.0, 0.0, QUARTER, False),
    (-QUARTER, 0.0, 0.0, -QUARTER, False),
    (QUARTER, 0.0, -0.4318, 0.0, True),
    (0.0, 0.0, 0.4162, 0.0, False),
    (-QUARTER, 0.0, 0.0, -QUARTER, False),
    (-QUARTER, 0.0091, 0.0, -QUARTER, False),
]
TIP_FROM_WRIST_YAW = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, 1.0], [-1.0, 0.0, 0.0]])
LOWER = np.array([-1.588, -0.925025, 0.0, -4.53786, -1.39626, -1.39626, -0.698132])
UPPER = np.array([1.588, 0.925025, 0.240, 4.53786, 1.39626, 1.39626, 1.39626])
# A recording's noise at a limit.
SLACK = 0.02
JOINTS = ["yaw", "pitch", "insertion", "roll", "wrist_pitch", "wrist_yaw", "jaw"]
POSE = ["x", "y", "z", "qx", "qy", "qz", "qw"]
QUANTILES = {"q01": 0.01, "q10": 0.1, "q50": 0.5, "q90": 0.9, "q99": 0.99}


def fail(text):
    raise SystemExit(f"error: {text}")


def tip_poses(joints):
    """(T, 6) joints to (T, 7) poses of the tip in the RCM frame: position, quaternion x, y, z, w."""
    steps = len(joints)
    rotation = np.tile(np.eye(3), (steps, 1, 1))
    position = np.zeros((steps, 3))
    for joint, (alpha, a, d, theta, slides) in enumerate(DH):
        q = joints[:, joint]
        along = d + (q if slides else np.zeros(steps))
        about = theta + (np.zeros(steps) if slides else q)
        ca, sa, ct, st = np.cos(alpha), np.sin(alpha), np.cos(about), np.sin(about)
        zero, one = np.zeros(steps), np.ones(steps)
        turn = np.stack([np.stack([ct, -st, zero], 1), np.stack([st * ca, ct * ca, -sa * one], 1), np.stack([st * sa, ct * sa, ca * one], 1)], 1)
        offset = np.stack([a * one, -sa * along, ca * along], 1)
        position = position + np.einsum("tij,tj->ti", rotation, offset)
        rotation = rotation @ turn
    return np.concatenate([position, quaternions(rotation @ TIP_FROM_WRIST_YAW)], 1)


def quaternions(rotations):
    """Unit quaternions x, y, z, w of (T, 3, 3), each on the side of the one before."""
    found = np.zeros((len(rotations), 4))
    for step, m in enumerate(rotations):
        # The largest of the four is computed first, so that nothing is divided by almost nothing.
        squares = np.array([m[0, 0] - m[1, 1] - m[2, 2], m[1, 1] - m[0, 0] - m[2, 2], m[2, 2] - m[0, 0] - m[1, 1], np.trace(m)]) + 1
        largest = int(squares.argmax())
        r = np.sqrt(squares[largest]) / 2
        x, y, z = m[2, 1] - m[1, 2], m[0, 2] - m[2, 0], m[1, 0] - m[0, 1]
        xy, xz, yz = m[0, 1] + m[1, 0], m[0, 2] + m[2, 0], m[1, 2] + m[2, 1]
        rest = [[4 * r * r, xy, xz, x], [xy, 4 * r * r, yz, y], [xz, yz, 4 * r * r, z], [x, y, z, 4 * r * r]][largest]
        found[step] = np.array(rest) / (4 * r)
        if step and found[step] @ found[step - 1] < 0:
            found[step] = -found[step]
    return found


def numbers(group, name, where):
    if name not in group:
        fail(f"{where}: {name} is missing")
    values = np.asarray(group[name], dtype=np.float64)
    if values.ndim != 2 or not len(values):
        fail(f"{where}: {name} has the shape {values.shape}, expected (steps, numbers)")
    if not np.isfinite(values).all():
        fail(f"{where}: {name} has a number that is not finite in step {int(np.argwhere(~np.isfinite(values))[0][0])}")
    return values


def arms_of(values, width, name, where):
    if values.shape[1] not in (width, 2 * width):
        fail(f"{where}: {name} has {values.shape[1]} numbers, expected {width} for each of one or two arms")
    return np.split(values, values.shape[1] // width, axis=1)


def joints_of(group, name, where):
    """The joints of each arm, which must be within its limits."""
    arms = arms_of(numbers(group, name, where), 7, name, where)
    for arm, values in enumerate(arms):
        outside = np.argwhere((values < LOWER - SLACK) | (values > UPPER + SLACK))
        if len(outside):
            step, joint = outside[0]
            limits = f"[{LOWER[joint]:.3f}, {UPPER[joint]:.3f}]"
            fail(
                f"{where}: {name} of arm {arm + 1}: {JOINTS[joint]} = {values[step, joint]:.4g} in step {step} is outside {limits}; "
                "six joints (rad, insertion m) and the jaw (rad) are expected"
            )
    return arms


def poses_with_jaw(arms):
    return [np.concatenate([tip_poses(values[:, :6]), values[:, 6:]], 1) for values in arms]


def commanded(group, options, where):
    """Commanded tip poses and jaws of each arm."""
    if options.action_pose:
        arms = arms_of(numbers(group, options.action_pose, where), 8, options.action_pose, where)
        for values in arms:
            length = np.linalg.norm(values[:, 3:7], axis=1)
            if np.abs(length - 1).max() > 1e-3:
                fail(f"{where}: {options.action_pose} has a quaternion of length {length[np.abs(length - 1).argmax()]:.4g}: are these deltas?")
        return arms
    return poses_with_jaw(joints_of(group, options.action_joints, where))


def images_of(group, name, steps, where):
    """Colour frames of one camera, one after another."""
    if name not in group:
        fail(f"{where}: {name} is missing")
    data = group[name]
    if len(data) != steps:
        fail(f"{where}: {name} has {len(data)} frames of {steps} steps")
    if data.dtype != np.uint8:
        fail(f"{where}: {name} is of {data.dtype}, expected uint8")
    if data.ndim == 4 and data.shape[3] == 3:
        return (np.asarray(data[step]) for step in range(steps))
    if data.ndim == 2:
        # Compressed, padded with zeros to the same length.
        return (np.asarray(Image.open(io.BytesIO(np.asarray(data[step]).tobytes())).convert("RGB")) for step in range(steps))
    return fail(f"{where}: {name} has the shape {data.shape}, expected (steps, height, width, 3)")


def episodes(options):
    """Each episode's group and name, in order."""
    if options.layout == "act":
        files = sorted(Path(options.source).glob("episode_*.hdf5"), key=lambda path: int(path.stem.split("_")[1]))
        if not files:
            fail(f"{options.source} has no episode_N.hdf5")
        for path in files:
            with h5py.File(path) as file:
                yield file, str(path)
        return
    with h5py.File(options.source) as file:
        demos = sorted((name for name in file.get("data", {}) if name.startswith("demo_")), key=lambda name: int(name.split("_")[1]))
        if not demos:
            fail(f"{options.source} has no data/demo_N")
        for name in demos:
            yield file["data"][name], f"{options.source}, {name}"


def cameras_of(group, options, where):
    """Names of the cameras, and where their frames are."""
    if options.layout == "act":
        found = sorted(group.get("observations/images", {}))
        return {name: f"observations/images/{name}" for name in found}
    return {path.split("/")[-1].removesuffix("_image"): path for path in options.images.split(",")}


class Writer:
    """A LeRobot v3 dataset, a data file an episode."""

    def __init__(self, out, options):
        self.out, self.options = Path(out), options
        if self.out.exists() and (not self.out.is_dir() or any(self.out.iterdir())):
            fail(f"{self.out} exists and is not an empty folder")
        self.rows, self.lengths, self.values, self.pixels = [], [], {}, {}
        self.sizes = None

    def add(self, state, tip, action, cameras):
        index, steps, start = len(self.lengths), len(state), sum(self.lengths)
        columns = {}
        for name, values, kind in (
            ("observation.state", state, pa.float32()),
            ("observation.tip_pose", tip, pa.float64()),
            ("action", action, pa.float32()),
        ):
            self.values.setdefault(name, []).append(values)
            flat = pa.array(values.flatten(), kind)
            columns[name] = pa.FixedSizeListArray.from_arrays(flat, values.shape[1])
        sizes = {}
        for name, frames in cameras.items():
            columns[f"observation.images.{name}"], sizes[name] = self.encode(name, frames)
        if self.sizes not in (None, sizes):
            fail(f"episode {index} has cameras {sizes}, those before {self.sizes}")
        self.sizes = sizes
        columns["timestamp"] = pa.array((np.arange(steps) / self.options.fps).astype(np.float32))
        integers = {"frame_index": np.arange(steps), "episode_index": np.full(steps, index), "index": start + np.arange(steps)}
        for name, values in (integers | {"task_index": np.zeros(steps)}).items():
            columns[name] = pa.array(values.astype(np.int64))
        path = self.out / f"data/chunk-{index // 1000:03}/file-{index % 1000:03}.parquet"
        path.parent.mkdir(parents=True, exist_ok=True)
        # Small pages, so that one image can be read without the others.
        pq.write_table(pa.table(columns), path, data_page_size=1, write_batch_size=1, use_dictionary=False, write_page_index=True)
        self.lengths.append(steps)

    def encode(self, name, frames):
        encoded, size = [], None
        for step, frame in enumerate(frames):
            if size not in (None, frame.shape):
                fail(f"camera {name}: frame {step} is {frame.shape}, those before {size}")
            size = frame.shape
            png = io.BytesIO()
            Image.fromarray(frame).save(png, "PNG", compress_level=1)
            encoded.append({"bytes": png.getvalue(), "path": f"frame-{step:06}.png"})
            if step % 10 == 0:
                counts = np.stack([np.bincount(frame[..., channel].ravel(), minlength=256) for channel in range(3)])
                total, images = self.pixels.get(name, (0, 0))
                self.pixels[name] = (total + counts, images + 1)
        return pa.array(encoded, pa.struct([("bytes", pa.binary()), ("path", pa.string())])), size

    def finish(self):
        meta = self.out / "meta"
        (meta / "episodes/chunk-000").mkdir(parents=True)
        task = self.options.task
        names = {"task_index": [0], "task": [task]}
        pandas = {"index_columns": ["task"], "columns": [], "column_indexes": [], "pandas_version": "2.2.3"}
        for name in names:
            kind = ("unicode", "object") if name == "task" else ("int64", "int64")
            pandas["columns"].append({"name": name, "field_name": name, "pandas_type": kind[0], "numpy_type": kind[1], "metadata": None})
        pq.write_table(pa.table(names).replace_schema_metadata({"pandas": json.dumps(pandas)}), meta / "tasks.parquet")
        ends = np.cumsum(self.lengths)
        count = len(self.lengths)
        table = {
            "episode_index": np.arange(count),
            "length": np.array(self.lengths),
            "data/chunk_index": np.arange(count) // 1000,
            "data/file_index": np.arange(count) % 1000,
            "dataset_from_index": ends - self.lengths,
            "dataset_to_index": ends,
            "meta/episodes/chunk_index": np.zeros(count, np.int64),
            "meta/episodes/file_index": np.zeros(count, np.int64),
        }
        pq.write_table(pa.table(table | {"tasks": [[task]] * count}), meta / "episodes/chunk-000/file-000.parquet")
        (meta / "stats.json").write_text(json.dumps(self.statistics(), indent=2))
        # Last, since it says how many episodes count.
        (meta / "info.json").write_text(json.dumps(self.info(count, int(ends[-1])), indent=2))

    def statistics(self):
        found = {}
        for name, parts in self.values.items():
            values = np.concatenate(parts)
            of = {"min": values.min(0), "max": values.max(0), "mean": values.mean(0), "std": values.std(0)}
            of |= {quantile: np.quantile(values, at, axis=0) for quantile, at in QUANTILES.items()}
            found[name] = {part: value.tolist() for part, value in of.items()} | {"count": [len(values)]}
        levels = np.arange(256) / 255
        for name, (counts, images) in self.pixels.items():
            share = counts / counts.sum(1, keepdims=True)
            mean = share @ levels
            present = counts > 0
            of = {
                "min": [levels[row][0] for row in present],
                "max": [levels[row][-1] for row in present],
                "mean": mean,
                "std": np.sqrt((share * (levels - mean[:, None]) ** 2).sum(1)),
            }
            of |= {part: [levels[(np.cumsum(row) >= at).argmax()] for row in share] for part, at in QUANTILES.items()}
            shaped = {part: [[[float(value)]] for value in values] for part, values in of.items()}
            found[f"observation.images.{name}"] = shaped | {"count": [images]}
        return found

    def info(self, episodes, frames):
        arms = self.values["observation.state"][0].shape[1] // 7
        named = lambda names: names if arms == 1 else [f"psm{arm}_{name}" for arm in (1, 2) for name in names]
        vector = lambda dtype, names: {"dtype": dtype, "shape": [len(named(names))], "names": named(names)}
        features = {
            "observation.state": vector("float32", JOINTS),
            "observation.tip_pose": vector("float64", POSE),
            "action": vector("float32", [*POSE, "jaw"]),
        }
        for name, shape in self.sizes.items():
            features[f"observation.images.{name}"] = {"dtype": "image", "shape": list(shape), "names": ["height", "width", "channels"]}
        for name in ("timestamp", "frame_index", "episode_index", "index", "task_index"):
            features[name] = {"dtype": "float32" if name == "timestamp" else "int64", "shape": [1], "names": None}
        return {
            "codebase_version": "v3.0",
            "robot_type": "dvrk_psm" if arms == 1 else "bi_dvrk_psm",
            "total_episodes": episodes,
            "total_frames": frames,
            "total_tasks": 1,
            "chunks_size": 1000,
            "data_files_size_in_mb": 100,
            "video_files_size_in_mb": 200,
            "fps": self.options.fps,
            "splits": {"train": f"0:{episodes}"},
            "data_path": "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet",
            "video_path": None,
            "features": features,
        }


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("layout", choices=["act", "robomimic"])
    parser.add_argument("source")
    parser.add_argument("--out", required=True)
    parser.add_argument("--fps", type=int, required=True)
    parser.add_argument("--task", required=True, help="the task in words")
    parser.add_argument("--joints", help="joints and jaw within an episode")
    parser.add_argument("--action-joints", help="commanded joints and jaw within an episode")
    parser.add_argument("--action-pose", help="commanded tip poses and jaws within an episode")
    parser.add_argument("--images", help="cameras' frames within an episode, with commas between them")
    parser.add_argument("--dh", type=Path, help="JSON with six rows [twist, length, offset along, offset about, slides] of another arm")
    options = parser.parse_args()
    if options.layout == "act":
        options.joints = options.joints or "observations/qpos"
        options.action_joints = options.action_joints or (None if options.action_pose else "action")
    elif not (options.joints and options.images and (options.action_joints or options.action_pose)):
        fail("robomimic's names differ from file to file: give --joints, --images, and --action-joints or --action-pose")
    if options.action_joints and options.action_pose:
        fail("--action-joints and --action-pose: one of them")
    if options.dh:
        DH[:] = [tuple(row) for row in json.loads(options.dh.read_text())]
    writer = Writer(options.out, options)
    for group, where in episodes(options):
        joints, actions = joints_of(group, options.joints, where), commanded(group, options, where)
        steps = len(joints[0])
        if len(actions) != len(joints) or len(actions[0]) != steps:
            fail(f"{where}: actions of {len(actions)} arms and {len(actions[0])} steps, joints of {len(joints)} and {steps}")
        named = cameras_of(group, options, where)
        if not named:
            fail(f"{where}: there is no camera")
        cameras = {name: images_of(group, path, steps, where) for name, path in named.items()}
        tips = np.concatenate([tip_poses(values[:, :6]) for values in joints], 1)
        writer.add(np.concatenate(joints, 1), tips, np.concatenate(actions, 1), cameras)
    writer.finish()
    print(f"{len(writer.lengths)} episodes, {sum(writer.lengths)} frames in {writer.out}")


if __name__ == "__main__":
    main()
