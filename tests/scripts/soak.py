#!/usr/bin/env python3
"""A long run in real time with an external policy that keeps the arm moving, watched from outside.

    make setup-python
    target/python/bin/python tests/scripts/soak.py [--trocar target/release/trocar] [--minutes 30] [--log-max-mb 64]

The policy looks through the endoscope and moves the tip on a circle of 4 mm above the organ, a chunk every 200 ms; the log is bounded. Each
half minute prints the resident memory of run and policy; at the end come the loop's timing, its page faults and allocations, and whether the
log's last part verifies.
"""

import argparse
import json
import math
import subprocess
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
    for line in Path(f"/proc/{process}/status").read_text().splitlines():
        if line.startswith("VmRSS:"):
            return int(line.split()[1]) / 1024.0
    return 0.0


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--trocar", default="target/release/trocar")
    parser.add_argument("--minutes", type=float, default=30.0)
    parser.add_argument("--log-max-mb", type=int, default=64)
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
        began = time.monotonic()
        while run.poll() is None:
            minutes = (time.monotonic() - began) / 60.0
            disk = sum(part.stat().st_size for part in Path(folder).glob("*.mcap")) / 1e6
            print(
                f"{minutes:5.1f} min  run {resident_mb(run.pid):6.1f} MB, policy {resident_mb('self'):6.1f} MB, log {disk:5.1f} MB",
                flush=True,
            )
            try:
                run.wait(30.0)
            except subprocess.TimeoutExpired:
                pass
        print(json.dumps(json.loads(result.read_text())["real_time"], indent=1))
        subprocess.run([args.trocar, "verify", "--part", str(log)], check=False)


if __name__ == "__main__":
    main()
