"""``python -m trocar.lerobot``: serves and converts checkpoints."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from ..server import serve
from .checkpoint import CheckpointError, check_served, convert, recipe_of, step_ns_of

_DESCRIPTION = "Policies of LeRobot for Trocar, and Trocar's for LeRobot."


def main(arguments: list[str] | None = None) -> int:
    """Runs the command; 2 for bad usage or input."""
    options = _parser().parse_args(arguments)
    try:
        if options.do == "convert":
            print(f"{convert(options.checkpoint, options.out)}: lerobot-eval --policy.path={options.out} --env.type=trocar")
        else:
            _serve(options)
    except CheckpointError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    return 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m trocar.lerobot", description=_DESCRIPTION)
    verbs = parser.add_subparsers(dest="do", required=True)
    server = verbs.add_parser("serve", help="serve a checkpoint to `trocar run` and `trocar eval --policy external:NAME`")
    server.add_argument("checkpoint", type=Path, help="a folder that LeRobot saved, or one of Trocar's with an ACT network")
    server.add_argument("--name", default="external", help="the name of the topics (default: external)")
    server.add_argument(
        "--query-every",
        type=int,
        metavar="STEPS",
        help="policy steps of 40 ms between queries; if not given, as trocar.json in the folder says, or half of what LeRobot would execute",
    )
    server.add_argument(
        "--fps",
        type=int,
        help="steps a second of what it answers, the frames a second of the dataset that it was trained on; if not given, as trocar.json in the "
        "folder says, or the dataset that train_config.json names",
    )
    server.add_argument("--device", default="cpu", help="where the network computes (default: cpu)")
    server.add_argument("--threads", type=int, default=1, help="threads of the network on the CPU (default: 1)")
    server.add_argument("--sessions", type=int, help="end after so many sessions; if not given, Ctrl-C ends it")
    converter = verbs.add_parser("convert", help="write a checkpoint of Trocar's as a folder that LeRobot's programs load")
    converter.add_argument("checkpoint", type=Path)
    converter.add_argument("out", type=Path)
    return parser


def _serve(options: argparse.Namespace) -> None:
    check_served(options.checkpoint)
    step_ns = step_ns_of(options.checkpoint, options.fps)
    import torch

    from .model import load

    torch.set_num_threads(options.threads)
    policy, query_every = load(options.checkpoint, step_ns, options.device)
    recipe = recipe_of(options.checkpoint) or {}
    mode = recipe.get("aggregation", {}).get("mode", "newest")
    wanted = f"--policy external:{options.name} --set control.aggregation.mode={mode}"
    print(f"{options.checkpoint}: serving, {1e9 / step_ns:.4g} steps a second; trocar run {wanted}", file=sys.stderr, flush=True)
    serve(
        policy,
        options.name,
        cameras=policy.cameras,
        query_every=options.query_every or query_every,
        history=policy.history,
        arms=policy.arms,
        step_ns=step_ns,
        sessions=options.sessions,
        title=f"LeRobot {options.checkpoint.name}",
    )


if __name__ == "__main__":
    sys.exit(main())
