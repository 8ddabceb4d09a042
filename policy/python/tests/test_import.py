"""`trocar import lerobot` on a dataset of LeRobot v2.0, written here by Arrow's own writer, ffmpeg and Pillow as LeRobot of that time did."""

from __future__ import annotations

import io
import json
import subprocess
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import trocar
from PIL import Image

FPS = 15
SIDE = 64
LENGTHS = (6, 4)
TASKS = ("grasp the needle", "lift the needle")
POSE = ["tip_x", "tip_y", "tip_z", "tip_qw", "tip_qx", "tip_qy", "tip_qz", "jaw"]

# Millimetres, degrees, w first, numbers by name and by index: none is the importer's own.
MAPPING = """
format = "lerobot"
length_unit = "mm"
angle_unit = "deg"
quaternion = "wxyz"
tip_beyond_wrist_m = 0.0

[[arms]]
tip_position = { feature = "observation.state", names = ["tip_x", "tip_y", "tip_z"] }
tip_orientation = { feature = "observation.state", names = ["tip_qw", "tip_qx", "tip_qy", "tip_qz"] }
jaw = { feature = "observation.state", names = ["jaw"] }
action_position = { feature = "action", indices = [0, 1, 2] }
action_orientation = { feature = "action", indices = [3, 4, 5, 6] }
action_jaw = { feature = "action", indices = [7] }

[[cameras]]
name = "endoscope"
feature = "observation.images.top"

[[cameras]]
name = "wrist"
feature = "observation.images.wrist"
"""


@dataclass
class Row:
    """What an arm was at one step, as an environment shows it."""

    joints: np.ndarray
    jaw: float
    tip: np.ndarray

    def in_their_units(self) -> list[float]:
        """As `MAPPING` says: mm, quaternion w first, degrees."""
        x, y, z, qx, qy, qz, qw = self.tip
        return [1e3 * x, 1e3 * y, 1e3 * z, qw, qx, qy, qz, float(np.degrees(self.jaw))]


@pytest.fixture(scope="module")
def demonstrations(binary: str) -> list[list[Row]]:
    """Episodes of an arm that moves about: one row more than an episode has frames, since an action is where the tip is next."""
    env = trocar.make("needle-lift", binary=binary)
    made = []
    for episode, length in enumerate(LENGTHS):
        random = np.random.default_rng(episode)
        seen, _ = env.reset(seed=episode)
        rows = []
        for _ in range(length + 1):
            rows.append(Row(seen["joints"][0], float(seen["jaw"][0]), seen["tip"][0]))
            seen, *_ = env.step(random.uniform(env.action_space.low, env.action_space.high).astype(np.float32))
        made.append(rows)
    env.close()
    return made


def picture(episode: int, step: int) -> np.ndarray:
    """A picture that says which it is: its left half by the episode, its right half by the step."""
    image = np.full((SIDE, SIDE, 3), 40, np.uint8)
    image[:, : SIDE // 2, 0] = 60 + 90 * episode
    image[:, SIDE // 2 :, 1] = 60 + 25 * step
    return image


def png(image: np.ndarray) -> bytes:
    written = io.BytesIO()
    Image.fromarray(image).save(written, "PNG")
    return written.getvalue()


def vectors(rows: list[list[float]]) -> pa.Array:
    """A fixed-size list of single precision a row, as the `datasets` library writes a sequence of known length."""
    return pa.FixedSizeListArray.from_arrays(pa.array(np.ravel(rows), pa.float32()), len(rows[0]))


def write_video(path: Path, images: list[np.ndarray]) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    size = ["-f", "rawvideo", "-pix_fmt", "rgb24", "-s", f"{SIDE}x{SIDE}", "-r", str(FPS), "-i", "-"]
    command = ["ffmpeg", "-loglevel", "error", *size, "-c:v", "libx264", "-pix_fmt", "yuv420p", "-g", "2", "-crf", "10", str(path)]
    subprocess.run(command, input=b"".join(image.tobytes() for image in images), check=True)


def write_lines(path: Path, values: list[dict[str, Any]]) -> None:
    path.write_text("".join(json.dumps(value) + "\n" for value in values))


def info() -> dict[str, Any]:
    """``meta/info.json`` with the keys that v2.0 has."""
    scalar = lambda dtype: {"dtype": dtype, "shape": [1], "names": None}  # noqa: E731
    whole = ("frame_index", "episode_index", "index", "task_index")
    shown = {"shape": [SIDE, SIDE, 3], "names": ["height", "width", "channel"]}
    codec = {"video.fps": float(FPS), "video.codec": "h264", "video.pix_fmt": "yuv420p", "video.is_depth_map": False, "has_audio": False}
    features = {
        "action": {"dtype": "float32", "shape": [8], "names": {"motors": [f"next_{name}" for name in POSE]}},
        "observation.state": {"dtype": "float32", "shape": [8], "names": {"motors": POSE}},
        "observation.images.top": {"dtype": "image", **shown},
        "observation.images.wrist": {"dtype": "video", **shown, "video_info": codec},
        "timestamp": scalar("float32"),
        "next.done": scalar("bool"),
        **{name: scalar("int64") for name in whole},
    }
    return {
        "codebase_version": "v2.0",
        "robot_type": "dvrk",
        "total_episodes": len(LENGTHS),
        "total_frames": sum(LENGTHS),
        "total_tasks": len(TASKS),
        "total_videos": len(LENGTHS),
        "total_chunks": 1,
        "chunks_size": 1000,
        "fps": FPS,
        "splits": {"train": f"0:{len(LENGTHS)}"},
        "data_path": "data/chunk-{episode_chunk:03d}/episode_{episode_index:06d}.parquet",
        "video_path": "videos/chunk-{episode_chunk:03d}/{video_key}/episode_{episode_index:06d}.mp4",
        "features": features,
    }


@pytest.fixture
def theirs(demonstrations: list[list[Row]], tmp_path: Path) -> Path:
    """The dataset's folder."""
    folder = tmp_path / "theirs"
    for part in ("meta", "data/chunk-000"):
        (folder / part).mkdir(parents=True)
    (folder / "meta/info.json").write_text(json.dumps(info()))
    write_lines(folder / "meta/tasks.jsonl", [{"task_index": index, "task": task} for index, task in enumerate(TASKS)])
    write_lines(
        folder / "meta/episodes.jsonl",
        [{"episode_index": index, "tasks": [TASKS[index]], "length": length} for index, length in enumerate(LENGTHS)],
    )
    # The statistics of all episodes in one file: v2.1 has those of each instead.
    state = np.array([row.in_their_units() for rows in demonstrations for row in rows[:-1]])
    parts = {name: getattr(state, name)(axis=0).tolist() for name in ("mean", "std", "min", "max")}
    (folder / "meta/stats.json").write_text(json.dumps({"observation.state": parts}))
    first = 0
    for episode, (rows, length) in enumerate(zip(demonstrations, LENGTHS)):
        steps = range(length)
        table = {
            "observation.state": vectors([rows[step].in_their_units() for step in steps]),
            "action": vectors([rows[step + 1].in_their_units() for step in steps]),
            "observation.images.top": pa.array([{"bytes": png(picture(episode, step)), "path": f"frame_{step:06d}.png"} for step in steps]),
            "timestamp": pa.array([step / FPS for step in steps], pa.float32()),
            "next.done": pa.array([step == length - 1 for step in steps]),
            "frame_index": pa.array(list(steps), pa.int64()),
            "episode_index": pa.array([episode] * length, pa.int64()),
            "index": pa.array([first + step for step in steps], pa.int64()),
            "task_index": pa.array([episode] * length, pa.int64()),
        }
        pq.write_table(pa.table(table), folder / f"data/chunk-000/episode_{episode:06d}.parquet")
        write_video(folder / f"videos/chunk-000/observation.images.wrist/episode_{episode:06d}.mp4", [picture(episode, step) for step in steps])
        first += length
    (folder / "my.toml").write_text(MAPPING)
    return folder


@pytest.fixture
def imported(theirs: Path, tmp_path: Path, session: Callable[..., Any]) -> Callable[..., tuple[int, str, Path]]:
    """Imports the dataset: exit code, what was said on standard error, and the new dataset's folder."""

    def run(*more: str) -> tuple[int, str, Path]:
        out = tmp_path / "out"
        code, _, err = session("import", "lerobot", str(theirs), "--mapping", str(theirs / "my.toml"), "--out", str(out), *more).end()
        return code, err, out

    return run


def test_a_dataset_of_version_2_0_comes_in_as_it_was(
    demonstrations: list[list[Row]], imported: Callable[..., tuple[int, str, Path]]
) -> None:
    code, err, out = imported("--task", "lift the needle")
    assert code == 0, err
    found = json.loads((out / "meta/info.json").read_text())
    assert (found["codebase_version"], found["fps"], found["total_episodes"], found["total_frames"]) == ("v3.0", FPS, 2, 10)
    table = pa.concat_tables([pq.read_table(file) for file in sorted(out.glob("data/**/*.parquet"))]).sort_by("index")
    column = lambda name: np.array(table[name].to_pylist())  # noqa: E731
    frames = [(episode, step) for episode, length in enumerate(LENGTHS) for step in range(length)]
    assert list(zip(column("episode_index"), column("frame_index"))) == frames
    np.testing.assert_allclose(column("timestamp"), [step / FPS for _, step in frames], atol=1e-6)
    state, tips, action = column("observation.state"), column("observation.tip_pose"), column("action")
    for row, (episode, step) in enumerate(frames):
        was, then = demonstrations[episode][step], demonstrations[episode][step + 1]
        # Joints by inverse kinematics of a pose in single precision, mm.
        np.testing.assert_allclose(state[row], [*was.joints, was.jaw], atol=2e-5)
        for numbers, meant in ((tips[row], was.tip), (action[row], [*then.tip, then.jaw])):
            side = np.sign(numbers[3:7] @ meant[3:7])
            np.testing.assert_allclose(numbers[:3], meant[:3], atol=1e-7)
            np.testing.assert_allclose(numbers[3:7] * side, meant[3:7], atol=1e-6)
            np.testing.assert_allclose(numbers[7:], meant[7:], atol=1e-6)
        for camera, tolerance in (("endoscope", 0), ("wrist", 8)):
            stored = table[f"observation.images.{camera}"][row].as_py()["bytes"]
            image = np.array(Image.open(io.BytesIO(stored)).convert("RGB"))
            # Away from the edge between the halves, which the codec of the video blurs.
            apart = np.abs(image.astype(int) - picture(episode, step))[:, [*range(24), *range(40, SIDE)]]
            assert apart.max() <= tolerance, (camera, episode, step)
    notes = [json.loads(line) for line in (out / "meta/trocar_episodes.jsonl").read_text().splitlines()]
    assert [note["instruction"] for note in notes] == list(TASKS)


def test_several_instructions_want_one_text(imported: Callable[..., tuple[int, str, Path]]) -> None:
    code, err, out = imported()
    assert code == 2 and not list(out.iterdir())
    assert all(text in err for text in ("2 instructions", *TASKS, "--task"))
    code, err, out = imported("--task", "grasp and lift the needle")
    assert code == 0, err
    tasks = pq.read_table(out / "meta/tasks.parquet").to_pandas()
    assert list(tasks.index) == ["grasp and lift the needle"]


@pytest.mark.parametrize(
    ("spoiled", "said"),
    [
        ("cut", ["episode_000001.parquet"]),
        ("short", ["episode_000001.parquet", "episode 1 is cut off by the end of the file, expected 4 rows"]),
        ("version", ["codebase_version", "v1.6"]),
        ("name", ["tip_zz of feature observation.state, tip_position of the mapping, is missing"]),
    ],
)
def test_what_is_no_such_dataset_is_refused(
    spoiled: str, said: list[str], theirs: Path, imported: Callable[..., tuple[int, str, Path]]
) -> None:
    data = theirs / "data/chunk-000/episode_000001.parquet"
    if spoiled == "cut":
        data.write_bytes(data.read_bytes()[:-100])
    elif spoiled == "short":
        pq.write_table(pq.read_table(data).slice(0, 3), data)
    elif spoiled == "version":
        meta = theirs / "meta/info.json"
        meta.write_text(meta.read_text().replace("v2.0", "v1.6"))
    else:
        (theirs / "my.toml").write_text(MAPPING.replace('"tip_z"', '"tip_zz"'))
    code, err, out = imported("--task", "lift the needle")
    assert code == 2 and all(text in err for text in said), err
