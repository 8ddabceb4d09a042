#!/usr/bin/env python3
"""A long run in real time with an external policy that keeps the arm moving, watched from outside.

    make setup-python
    target/python/bin/python tests/scripts/soak.py [--trocar target/release/trocar] [--minutes 30] [--log-max-mb 64] [--growth-mb 32]

The policy looks through the endoscope and moves the tip on a circle of 4 mm above the organ, a chunk every 200 ms; the log is bounded. Each
half minute prints the resident memory of run, cameras' process and policy; at the end come the loop's timing, its page faults and allocations, and
whether the log's last part verifies. Exit code 1 if a process grew by more than --growth-mb in the second half, if the control thread allocated, if
the log does not verify, or if the run ended otherwise than by its time.
"""

import argparse
import json
import math
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path

import numpy as np
import trocar

RADIUS_M = 0.004
STEPS_A_TURN = 100
CHUNK = 20


class Circles:
    """Keeps the tip on a circle around where it first saw it."""

    def reset(self, seed: int) -> None:
        self.centre: np.ndarray | None = None

    def infer(self, observation: trocar.Observation) -> list[np.ndarray]:
        (arm,) = observation.arms
        if self.centre is None:
            self.centre = arm.here.copy()
            self.first = observation.step
        rows = np.tile(self.centre, (CHUNK, 1))
        for row, target in enumerate(rows):
            elapsed = observation.step + row - self.first
            angle = math.tau * elapsed / STEPS_A_TURN
            target[0] += RADIUS_M * math.sin(angle)
            target[1] += RADIUS_M * (1.0 - math.cos(angle))
        return [rows]


def resident_mb(process: int | str) -> float:
    try:
        lines = Path(f"/proc/{process}/status").read_text().splitlines()
    except OSError:
        # It is gone.
        return 0.0
    for line in lines:
        if line.startswith("VmRSS:"):
            return int(line.split()[1]) / 1024.0
    return 0.0


def cameras_of(run: int) -> int | None:
    """The process that draws the run's cameras, which any of its threads may have started."""
    for children in Path(f"/proc/{run}/task").glob("*/children"):
        try:
            for child in children.read_text().split():
                if Path(f"/proc/{child}/cmdline").read_bytes().split(b"\0")[1:2] == [b"cameras"]:
                    return int(child)
        except OSError:
            # A thread or a child that has just ended.
            continue
    return None


def resident(run: int) -> dict[str, float]:
    """Resident memory of each process, MB, of those that there are."""
    processes = {"run": run, "cameras": cameras_of(run), "policy": "self"}
    found = {}
    for name, process in processes.items():
        if process is not None and (memory := resident_mb(process)) > 0.0:
            found[name] = memory
    return found


def growth(samples: list[dict[str, float]]) -> dict[str, float]:
    """By how much each process grew in the second half, MB."""
    late = samples[len(samples) // 2 :] or [{}]
    return {name: max(sample.get(name, 0.0) for sample in late) - late[0][name] for name in late[0]}


def complaints(result: dict, samples: list[dict[str, float]], growth_mb: float, verified: bool) -> list[str]:
    """What is not as it should be."""
    found = [f"{name} grew by {grew:.1f} MB in the second half" for name, grew in growth(samples).items() if grew > growth_mb]
    if any("cameras" not in sample for sample in samples):
        found.append("the cameras' process was gone")
    if (allocations := result["real_time"]["thread"]["allocations"]) > 0:
        found.append(f"the control thread allocated {allocations} times")
    if not verified:
        found.append("the log does not verify")
    if not result["reason"].startswith("needle not lifted within"):
        found.append(f"the run ended otherwise: {result['reason']}")
    return found


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--trocar", default="target/release/trocar")
    parser.add_argument("--minutes", type=float, default=30.0)
    parser.add_argument("--log-max-mb", type=int, default=64)
    parser.add_argument("--growth-mb", type=float, default=32.0)
    args = parser.parse_args()
    served = threading.Thread(
        target=lambda: trocar.serve(Circles(), cameras=["endoscope"], query_every=5, sessions=1, name="soak"), daemon=True
    )
    served.start()
    with tempfile.TemporaryDirectory() as folder:
        log, result = Path(folder) / "soak.mcap", Path(folder) / "soak.json"
        command = [args.trocar, "run", "--task", "needle-lift", "--policy", "external:soak", "--json", str(result)]
        command += ["--log", str(log), "--log-max-mb", str(args.log_max_mb)]
        command += ["--set", f"scene.episode.time_limit_s={args.minutes * 60.0}"]
        run = subprocess.Popen(command)
        began, samples = time.monotonic(), []
        while run.poll() is None:
            minutes = (time.monotonic() - began) / 60.0
            disk = sum(part.stat().st_size for part in Path(folder).glob("*.mcap")) / 1e6
            now = resident(run.pid)
            if "run" in now and minutes > 0.2:
                samples.append(now)
            memory = ", ".join(f"{name} {mb:6.1f} MB" for name, mb in now.items())
            print(f"{minutes:5.1f} min  {memory}, log {disk:5.1f} MB", flush=True)
            try:
                run.wait(30.0)
            except subprocess.TimeoutExpired:
                pass
        summary = json.loads(result.read_text())
        timing = {name: value for name, value in summary["real_time"].items() if name != "histograms"}
        print(json.dumps(timing, indent=1))
        verified = subprocess.run([args.trocar, "verify", "--part", str(log)], check=False).returncode == 0
    found = complaints(summary, samples, args.growth_mb, verified)
    for complaint in found:
        print(f"soak: {complaint}", file=sys.stderr)
    return int(bool(found))


if __name__ == "__main__":
    sys.exit(main())
