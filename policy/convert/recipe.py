"""`trocar.json` beside a converted policy: what its actions mean, how fast they follow each other, what it is shown. Without torch."""

from __future__ import annotations

import argparse
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NoReturn

# A session asks its policy by these steps, ns, whatever the policy's own are.
POLICY_STEP_NS = 40_000_000
# Steps of a chunk are 1 ms or longer.
FPS_MAX = 1000


def fail(text: str) -> NoReturn:
    raise SystemExit(f"error: {text}")


def fps(text: str) -> int:
    """The value of --fps."""
    try:
        found = int(text)
    except ValueError:
        found = 0
    if not 1 <= found <= FPS_MAX:
        raise argparse.ArgumentTypeError(f"{text}: allowed are 1 to {FPS_MAX}, whole steps a second")
    return found


def size_of(text: str, option: str) -> tuple[int, int]:
    try:
        width, height = (int(part) for part in text.split("x"))
    except ValueError:
        fail(f"{option} {text}: expected WIDTHxHEIGHT")
    return width, height


def add_shared_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--query-every", type=int, metavar="STEPS", help="policy steps of 40 ms from one query to the next; half a chunk if not given"
    )
    parser.add_argument(
        "--recorded", metavar="WIDTHxHEIGHT", help="size of the cameras' frames, a whole multiple of the network's; the same if not given"
    )
    parser.add_argument("--task", default="", help="the task in words")


def add_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--actions",
        choices=["observation_relative"],
        help="write trocar.json, without which a policy is not run: the file does not say what its actions mean, so that you have to. "
        "observation_relative: of each arm the translation from the measured tip in the RCM frame (m), the rotation vector in the "
        "measured tip's frame (rad), the jaw (rad)",
    )
    parser.add_argument("--fps", type=fps, help="steps of a chunk a second, those of the demonstrations; goes with --actions")
    add_shared_options(parser)


def parsed(parser: argparse.ArgumentParser) -> argparse.Namespace:
    """The command line; the meaning of actions and their rate are given together or not at all."""
    options = parser.parse_args()
    if options.actions is not None and options.fps is None:
        fail("--fps must be given with --actions: the file does not say how fast its steps follow each other")
    if options.fps is not None and options.actions is None:
        fail("--fps goes with --actions: without it no trocar.json is written")
    return options


def policy_steps(steps: int, step_ns: int) -> int:
    """`steps` of a policy's, of `step_ns` each, as policy steps: no more than they last, and no more of them."""
    return min(max(steps * step_ns // POLICY_STEP_NS, 1), steps)


def recipe(
    options: argparse.Namespace,
    *,
    arms: int,
    cameras: Mapping[str, Sequence[int]],
    query_every: int,
    preset: str,
    variants: Mapping[str, Any],
    made: str,
) -> dict[str, Any]:
    """`trocar.json`; `cameras` are width and height of their frames, by feature, `query_every` the policy's own steps between queries."""
    step_ns = 1_000_000_000 // options.fps
    return {
        "format": 1,
        "arms": arms,
        "action_representation": options.actions,
        "step_ns": step_ns,
        "query_every_steps": options.query_every or policy_steps(query_every, step_ns),
        "aggregation": {"mode": "newest", "decay": 0.01},
        "cameras": [{"feature": camera, "width": width, "height": height} for camera, (width, height) in cameras.items()],
        "preset": preset,
        "variants": variants,
        "recipe": made,
        "dataset": {"task": options.task, "episodes": 0, "frames": 0, "fps": options.fps},
        "seed": 0,
        "training": None,
    }


def write_json(path: Path, value: Any) -> None:
    path.write_text(json.dumps(value, indent=2, sort_keys=True) + "\n")


def write(
    folder: Path,
    options: argparse.Namespace,
    source: str | Path,
    preset: str,
    cameras: Sequence[str],
    size: tuple[int, int] | None,
    state_dim: int,
    query_every: int,
    variants: Mapping[str, Any],
) -> None:
    """Writes `trocar.json` into `folder`, unless the user does not say what the actions mean. `size` is that of the network's images."""
    if options.actions is None:
        print("no trocar.json: --actions was not given, so the folder can be loaded but not run")
        return
    if state_dim % 7 or state_dim // 7 not in (1, 2):
        fail(f"{state_dim} numbers of state are not those of one or two arms, 7 each")
    recorded = size_of(options.recorded, "--recorded") if options.recorded else size
    if recorded is None:
        fail("--recorded must be given: the network has no size of images")
    content = recipe(
        options,
        arms=state_dim // 7,
        cameras={camera: recorded for camera in cameras},
        query_every=query_every,
        preset=preset,
        variants=variants,
        made=f"converted from {Path(source).name}",
    )
    write_json(folder / "trocar.json", content)
