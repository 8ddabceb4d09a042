#!/usr/bin/env python3
"""A policy that LeRobot's classes run drives the needle lift, beside our engine on the same checkpoint.

Requirements: Python 3.12, lerobot==0.6.1 torch==2.11.0 torchvision==0.26.0, and `pip install policy/python[gym,pandas]`

    cargo build --locked -p trocar
    python tests/scripts/lerobot_policies.py target/lerobot-policies [--policy FOLDER] [--task TASK] [--trials 10]

`python -m trocar.lerobot serve` runs the checkpoint in a process of its own: LeRobot's loader (strict), processors and ACT class, with
the backbone's normalisation of ours where the checkpoint has it. It prints how far the two sides are apart, and fails beyond 5e-6.

  chunks     two runs of one seed in lockstep: every chunk of the one log against that of the other. The first observation is the
             same to the bit; later ones differ by what the first chunk's rounding did
  success    `trocar eval` of both on the same seeds: the same trials succeed
  real time  one run in real time
"""

import argparse
import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import trocar

ROOT = Path(__file__).resolve().parents[2]
TROCAR = Path(os.environ.get("TROCAR", ROOT / "target/debug/trocar"))
# Metres, components of a quaternion, radians.
CHUNK_TOLERANCE = 5e-6
failures = []


def report(what, found, tolerance):
    good = bool(found <= tolerance)
    print(f"{what:<64} {found:.3g} (at most {tolerance:.3g}){'' if good else '  FAILED'}", flush=True)
    if not good:
        failures.append(what)


def served(checkpoint, name, command):
    """Runs `command` of ours beside LeRobot's policy on the topics `name`; its exit code."""
    serve = [sys.executable, "-m", "trocar.lerobot", "serve", checkpoint, "--name", name, "--sessions", "1"]
    server = subprocess.Popen(serve)
    try:
        mode = json.loads((checkpoint / "trocar.json").read_text())["aggregation"]["mode"]
        awaited = ["--policy", f"external:{name}", "--policy-timeout", "120", "--set", f"control.aggregation.mode={mode}"]
        done = subprocess.run([*command, *awaited], stdout=subprocess.DEVNULL)
        server.wait(60)
    finally:
        server.kill()
        server.wait()
    if done.returncode not in (0, 1):
        sys.exit(f"{command}: exit code {done.returncode}")


def own(checkpoint, command):
    done = subprocess.run([*command, "--policy", checkpoint], stdout=subprocess.DEVNULL)
    if done.returncode not in (0, 1):
        sys.exit(f"{command}: exit code {done.returncode}")


def chunks(log):
    """The targets of every chunk (steps, 8), by topic and observation."""
    found = {}
    for topic, table in trocar.read_log(log).items():
        if not topic.endswith("chunk"):
            continue
        for row in table.itertuples():
            found[topic, int(row.observed_at_ns)] = np.array(row.targets)
    return found


def distance(ours, theirs):
    """The greatest difference of targets; of a turn's two quaternions either."""
    assert ours.shape == theirs.shape, (ours.shape, theirs.shape)
    side = np.sign((ours[:, 3:7] * theirs[:, 3:7]).sum(axis=1, keepdims=True))
    turned = np.concatenate([theirs[:, :3], theirs[:, 3:7] * side, theirs[:, 7:]], axis=1)
    return np.abs(turned - ours).max()


def compare_chunks(work, checkpoint, task, seed):
    run = [TROCAR, "run", "--task", task, "--lockstep", "--seed", str(seed), "--log"]
    own(checkpoint, [*run, work / "ours.mcap"])
    served(checkpoint, f"lerobot-{os.getpid()}", [*run, work / "theirs.mcap"])
    ours, theirs = chunks(work / "ours.mcap"), chunks(work / "theirs.mcap")
    assert ours, "the log has no chunk"
    first = min(stamp for _, stamp in ours)
    both = ours.keys() & theirs.keys()
    apart = {key: distance(ours[key], theirs[key]) for key in both}
    print(f"{len(ours)} and {len(theirs)} chunks of {len(ours[min(ours)])} steps")
    report("chunks of the first observation", max(value for (_, stamp), value in apart.items() if stamp == first), CHUNK_TOLERANCE)
    print(f"{'chunks of all common observations':<64} {max(apart.values()):.3g}")


def compare_success(work, checkpoint, task, trials):
    evaluate = [TROCAR, "eval", "--task", task, "--trials", str(trials), "--json"]
    own(checkpoint, [*evaluate, work / "ours.json"])
    served(checkpoint, f"lerobot-{os.getpid()}", [*evaluate, work / "theirs.json"])
    ours, theirs = (
        {one["seed"]: one["success"] for one in json.loads((work / name).read_text())["episodes"]} for name in ("ours.json", "theirs.json")
    )
    print(f"{task}: {sum(ours.values())} of {trials} by our engine, {sum(theirs.values())} of {trials} by LeRobot")
    report("trials with another verdict", sum(ours[seed] != theirs[seed] for seed in ours), 0)


def in_real_time(work, checkpoint, task, seed):
    result = work / "run.json"
    served(checkpoint, f"lerobot-{os.getpid()}", [TROCAR, "run", "--task", task, "--seed", str(seed), "--json", result])
    found = json.loads(result.read_text())
    policy = found["policy"]
    print(f"real time: {found['reason']}, {policy['queries']} queries, {policy['refused']} refused; {json.dumps(policy.get('inference_ms'))}")
    report("real time, not a success", not found["success"], 0)


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("work", type=Path)
    parser.add_argument("--task", default="needle-lift")
    parser.add_argument("--policy", type=Path, default=ROOT / "config/policies/needle-lift/act-compact")
    parser.add_argument("--trials", type=int, default=10)
    parser.add_argument("--seed", type=int, default=7)
    options = parser.parse_args()
    work = options.work.resolve()
    shutil.rmtree(work, ignore_errors=True)
    work.mkdir(parents=True)
    compare_chunks(work, options.policy, options.task, options.seed)
    compare_success(work, options.policy, options.task, options.trials)
    in_real_time(work, options.policy, options.task, options.seed)
    if failures:
        sys.exit(f"{len(failures)} failed: {'; '.join(failures)}")
    print("all good")


if __name__ == "__main__":
    main()
