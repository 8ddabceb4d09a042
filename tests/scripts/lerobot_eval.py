#!/usr/bin/env python3
"""`lerobot-eval` on the five tasks, beside `trocar eval` on the same seeds.

Requirements: Python 3.12, lerobot==0.6.1 torch==2.11.0 torchvision==0.26.0, and
`pip install policy/python[gym] policy/python/lerobot_env_trocar`

    cargo build --locked -p trocar
    python tests/scripts/lerobot_eval.py target/lerobot-eval [--trials needle-lift=10] [--tasks needle-lift,suture-pad]

Each task's committed policy is converted (`python -m trocar.lerobot convert`), and LeRobot's program loads it, makes the environment that
the plug-in registers, and rolls out. LeRobot executes one action a step, without delay; `trocar eval` delays chunks by 160 ms and
aggregates. So an episode is not the same to the bit; what is compared is how many succeed, and which.
"""

import argparse
import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
TROCAR = Path(os.environ.get("TROCAR", ROOT / "target/debug/trocar"))
POLICIES = {
    "needle-lift": "act-compact",
    "needle-handover": "act-compact",
    "tissue-retraction": "act-small",
    "suture-pad": "act-compact",
    "block-transfer": "act-compact",
}
FIRST_SEED = 1_000_000


def ours(work, task, folder, trials):
    result = work / f"{task}.json"
    command = [TROCAR, "eval", "--task", task, "--policy", folder, "--trials", str(trials), "--seed", str(FIRST_SEED), "--json", result]
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    return [episode["success"] for episode in json.loads(result.read_text())["episodes"]]


def theirs(work, task, folder, trials):
    converted, out = work / f"{task}-policy", work / f"{task}-lerobot"
    subprocess.run([sys.executable, "-m", "trocar.lerobot", "convert", folder, converted], check=True, stdout=subprocess.DEVNULL)
    program = Path(sys.executable).parent / "lerobot-eval"
    command = [program, f"--policy.path={converted}", "--env.type=trocar", f"--env.task={task}", f"--output_dir={out}"]
    command += [f"--eval.n_episodes={trials}", "--eval.batch_size=1", f"--seed={FIRST_SEED}"]
    log = work / f"{task}.log"
    environment = os.environ | {"TROCAR": str(TROCAR), "HF_HUB_OFFLINE": "1"}
    with open(log, "w") as file:
        done = subprocess.run(command, env=environment, stdout=file, stderr=subprocess.STDOUT)
    if done.returncode:
        sys.exit(f"{task}: lerobot-eval failed:\n{log.read_text()[-3000:]}")
    (found,) = json.loads((out / "eval_info.json").read_text())["per_task"]
    assert found["task_group"] == task, found
    return found["metrics"]["successes"]


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("work", type=Path)
    parser.add_argument("--tasks", default=",".join(POLICIES), help="with commas between them")
    parser.add_argument("--trials", nargs="*", default=["needle-lift=10"], metavar="TASK=N", help="trials of a task; 1 if not given")
    options = parser.parse_args()
    work = options.work.resolve()
    shutil.rmtree(work, ignore_errors=True)
    work.mkdir(parents=True)
    trials = {task: int(count) for task, count in (pair.split("=") for pair in options.trials)}
    apart = 0
    for task in options.tasks.split(","):
        count = trials.get(task, 1)
        folder = ROOT / "config/policies" / task / POLICIES[task]
        by_trocar, by_lerobot = ours(work, task, folder, count), theirs(work, task, folder, count)
        assert len(by_trocar) == len(by_lerobot) == count
        differ = [FIRST_SEED + index for index in range(count) if by_trocar[index] != by_lerobot[index]]
        print(f"{task}: lerobot-eval {sum(by_lerobot)} of {count}, trocar eval {sum(by_trocar)} of {count}; seeds apart: {differ}", flush=True)
        apart = max(apart, abs(sum(by_trocar) - sum(by_lerobot)) / count)
    if apart > 0.2:
        sys.exit("success differs by more than a fifth of the trials")


if __name__ == "__main__":
    main()
