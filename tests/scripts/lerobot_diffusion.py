#!/usr/bin/env python3
"""LeRobot's Diffusion Policy, trained by `lerobot-train` on what `trocar record` made, and evaluated by `trocar eval` and `lerobot-eval`.

Requirements: Python 3.12, lerobot==0.6.1 with its extras training and diffusion, torch==2.11.0 torchvision==0.26.0, av<16, and
`pip install policy/python[gym] policy/python/lerobot_env_trocar`

    cargo build --locked -p trocar
    python tests/scripts/lerobot_diffusion.py target/lerobot-diffusion [--episodes 20] [--steps 300] [--trials 5]

What is tested is that the way works from end to end: a small network after some hundred steps on a processor lifts few needles or none; more
steps, a larger network and a GPU are options. It fails if training's loss does not fall by half, if an evaluation breaks off, or if a chunk is
refused.
"""

import argparse
import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
TROCAR = Path(os.environ.get("TROCAR", ROOT / "target/debug/trocar"))
BESIDE = Path(sys.executable).parent
FIRST_SEED = 1_000_000


def run(name, command, work):
    """Runs `command` and gives back what it said; it must end well."""
    log = work / f"{name}.log"
    # Threads that wait for each other spin: on a busy machine one is faster than two.
    environment = os.environ | {"TROCAR": str(TROCAR), "HF_HUB_OFFLINE": "1", "OMP_NUM_THREADS": "1"}
    with open(log, "w") as file:
        done = subprocess.run([str(part) for part in command], env=environment, stdout=file, stderr=subprocess.STDOUT)
    said = log.read_text()
    if done.returncode:
        sys.exit(f"{name} failed:\n{said[-3000:]}")
    return said


def small_scene(work, side):
    """The needle lift with small pictures."""
    text = (ROOT / "config/tasks/needle-lift/scene.toml").read_text()
    file = work / "small.toml"
    file.write_text(re.sub(r"^(width|height) = 512$", rf"\1 = {side}", text, flags=re.M))
    return ["--scene", file, "--set", "scene.rendering.shading=plain"]


def train(work, demos, options):
    steps = options.steps
    command = [BESIDE / "lerobot-train", "--dataset.repo_id=local/demos", f"--dataset.root={demos}", "--policy.type=diffusion"]
    command += [f"--policy.device={options.device}", "--policy.push_to_hub=false", "--wandb.enable=false", f"--output_dir={work / 'train'}"]
    command += [f"--steps={steps}", f"--save_freq={steps}", "--log_freq=10", "--env_eval_freq=0"]
    command += [f"--batch_size={options.batch}", f"--num_workers={options.workers}"]
    command += ["--policy.n_obs_steps=2", "--policy.horizon=32", "--policy.n_action_steps=30", f"--policy.down_dims=[{options.dims}]"]
    command += ["--policy.noise_scheduler_type=DDIM", "--policy.num_inference_steps=10", "--policy.optimizer_lr=3e-4"]
    command += ["--policy.pretrained_backbone_weights=null", "--policy.use_group_norm=true"]
    command += ["--policy.scheduler_warmup_steps=50", "--seed=1"]
    said = run("train", command, work)
    losses = [float(loss) for loss in re.findall(r"loss:([0-9.]+)", said)]
    print(f"lerobot-train: {steps} steps, loss {losses[0]:.3f} to {losses[-1]:.3f}", flush=True)
    if losses[-1] > losses[0] / 2:
        sys.exit("the loss has not fallen by half")
    return work / f"train/checkpoints/{steps:06d}/pretrained_model"


def evaluate_served(work, policy, scene, trials):
    name, result = f"diffusion-{os.getpid()}", work / "eval.json"
    server = subprocess.Popen([sys.executable, "-m", "trocar.lerobot", "serve", policy, "--name", name, "--sessions", "1"])
    try:
        wanted = ["--policy", f"external:{name}", "--policy-timeout", "120", "--set", "control.aggregation.mode=newest"]
        command = [TROCAR, "eval", "--task", "needle-lift", *scene, *wanted, "--trials", trials, "--seed", FIRST_SEED, "--json", result]
        run("eval", command, work)
        server.wait(60)
    finally:
        server.kill()
        server.wait()
    episodes = json.loads(result.read_text())["episodes"]
    print(f"trocar eval of the served policy: {sum(one['success'] for one in episodes)} of {trials}", flush=True)
    for one in episodes:
        print(f"  seed {one['seed']}: {one['reason']}")


def evaluate_by_lerobot(work, policy, scene, options):
    trials, side = options.trials, options.side
    command = [BESIDE / "lerobot-eval", f"--policy.path={policy}", "--env.type=trocar", "--env.task=needle-lift"]
    command += [f"--env.observation_height={side}", f"--env.observation_width={side}", f"--env.options={' '.join(map(str, scene))}"]
    command += [f"--eval.n_episodes={trials}", "--eval.batch_size=1", f"--seed={FIRST_SEED}", f"--output_dir={work / 'lerobot-eval'}"]
    run("lerobot-eval", command, work)
    overall = json.loads((work / "lerobot-eval/eval_info.json").read_text())["overall"]
    print(f"lerobot-eval: {overall['pc_success'] * overall['n_episodes'] / 100:.0f} of {overall['n_episodes']}", flush=True)


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("work", type=Path)
    parser.add_argument("--episodes", type=int, default=20)
    parser.add_argument("--steps", type=int, default=300)
    parser.add_argument("--trials", type=int, default=5)
    parser.add_argument("--side", type=int, default=96, help="of the images, pixels")
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--batch", type=int, default=8)
    parser.add_argument("--workers", type=int, default=0, help="processes that load images")
    parser.add_argument("--dims", default="128,256", help="channels of the network's levels")
    options = parser.parse_args()
    work = options.work.resolve()
    shutil.rmtree(work, ignore_errors=True)
    work.mkdir(parents=True)
    scene, demos = small_scene(work, options.side), work / "demos"
    recording = [TROCAR, "record", "--task", "needle-lift", *scene, "--episodes", options.episodes, "--source", "expert", "--out", demos]
    run("record", [*recording, "--instruction", "lift the needle"], work)
    policy = train(work, demos, options)
    evaluate_served(work, policy, scene, options.trials)
    evaluate_by_lerobot(work, policy, scene, options)
    print("all good")


if __name__ == "__main__":
    main()
