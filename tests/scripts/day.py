#!/usr/bin/env python3
"""A day in lockstep virtual time, watched from outside, and a part of it twice.

    tests/scripts/day.py [--trocar target/release/trocar] [--task needle-lift] [--hours 24] [--part-hours 1] [--every 60]

A random policy moves the arm against boundaries all day, in one episode of one process; without cameras and log, which lockstep would wait for.
Prints the resident memory while it runs, and at the end ticks, how long a tick took, what filter and guard did, and the command hash. The part runs
twice before: both hashes have to be equal. Lockstep has no deadline and so no overrun; a tick that is missing shows in their number.
"""

import argparse
import json
import subprocess
import sys
import tempfile
import time
from pathlib import Path

SEED = 3
TICKS_A_HOUR = 3_600_000


def resident_mb(process: int) -> float:
    """What the process has in memory now, MB; 0 once it has ended."""
    try:
        lines = Path(f"/proc/{process}/status").read_text().splitlines()
    except FileNotFoundError:
        return 0.0
    return sum(int(line.split()[1]) for line in lines if line.startswith("VmRSS:")) / 1024.0


def episode(args: argparse.Namespace, hours: float) -> dict:
    """Runs that many hours of virtual time; the result with the wall-clock time and the memory at each look."""
    with tempfile.TemporaryDirectory() as folder:
        result = Path(folder) / "day.json"
        command = [args.trocar, "run", "--task", args.task, "--policy", "random", "--lockstep", "--seed", str(SEED)]
        command += ["--set", f"scene.episode.time_limit_s={hours * 3600.0}", "--json", str(result)]
        began, memory = time.monotonic(), []
        run = subprocess.Popen(command, stdout=subprocess.DEVNULL)
        while run.poll() is None:
            try:
                run.wait(args.every if memory else 5.0)
            except subprocess.TimeoutExpired:
                memory.append(resident_mb(run.pid))
                print(f"{time.monotonic() - began:7.0f} s  {memory[-1]:7.1f} MB", flush=True)
        if not result.exists():
            sys.exit(f"the run ended with {run.returncode} and left no result")
        found = json.loads(result.read_text())
    expected = round(hours * TICKS_A_HOUR)
    if found["ticks"] != expected:
        sys.exit(f"{found['ticks']} ticks, not {expected}: {found['reason']}")
    return {**found, "wall_s": time.monotonic() - began, "memory_mb": memory}


def report(found: dict) -> None:
    tick, qp, memory = found["tick_us"], found["qp"], found["memory_mb"]
    print(f"{found['ticks']} ticks in {found['wall_s']:.0f} s; a tick {tick['p50']:.1f} us (p50), {tick['p99']:.1f} us (p99)")
    print(f"filter solved {qp['solved']}, failed {qp['failed']}; guard intervened {found['guard_interventions']} times")
    if memory:
        print(f"resident memory {memory[0]:.1f} MB at the first look, {memory[-1]:.1f} MB at the last, {max(memory):.1f} MB at most")
    print(f"command hash {found['command_hash']}", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--trocar", default="target/release/trocar")
    parser.add_argument("--task", default="needle-lift")
    parser.add_argument("--hours", type=float, default=24.0)
    parser.add_argument("--part-hours", type=float, default=1.0)
    parser.add_argument("--every", type=float, default=60.0)
    args = parser.parse_args()
    parts = [episode(args, args.part_hours) for _ in range(2)]
    for part in parts:
        report(part)
    if parts[0]["command_hash"] != parts[1]["command_hash"]:
        sys.exit("the part's two runs differ")
    day = episode(args, args.hours)
    report(day)
    broken = [place for place in day["measured_clearance"] if place["ticks_beyond"] > 0]
    if day["qp"]["failed"] or broken:
        sys.exit(f"filter failed {day['qp']['failed']} times, beyond boundaries: {broken}")


if __name__ == "__main__":
    main()
