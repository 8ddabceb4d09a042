#!/usr/bin/env python3
"""Wake-up delay of trocar's control thread beside cyclictest's, at the same priority and period, in turns on the same machine.

    apt-get install rt-tests
    tests/scripts/wake_ups.py [--trocar target/release/trocar] [--rounds 7] [--seconds 5] [--busy 2] [--no-fifo] [--cpu 1] [--idle-states]

Prints each round's percentiles in microseconds, and the medians over the rounds with their ratio. `--busy N` lets N processes compute
meanwhile; `--no-fifo` takes both from SCHED_FIFO; `--cpu N` keeps both on one core. As cyclictest does, the run keeps cores out of idle states, but with
`--idle-states`.
"""

import argparse
import json
import statistics
import subprocess
import sys
import tempfile
from pathlib import Path

PRIORITY = 80
PERIOD_US = 1000
HISTOGRAM_US = 50_000


def cyclictest(args: argparse.Namespace) -> dict[str, float]:
    """Percentiles of cyclictest's histogram; what lies beyond it counts as its end."""
    command = ["cyclictest", "--quiet", "--mlockall", f"--interval={PERIOD_US}", f"--histogram={HISTOGRAM_US}"]
    command += [f"--loops={args.seconds * 1_000_000 // PERIOD_US}"]
    command += ["--policy=other"] if args.no_fifo else [f"--priority={PRIORITY}"]
    if args.cpu is not None:
        command += [f"--affinity={args.cpu}"]
    lines = subprocess.run(command, check=True, capture_output=True, text=True).stdout.splitlines()
    counts = [(int(line.split()[0]), int(line.split()[1])) for line in lines if line[:1].isdigit()]
    highest = next(line for line in lines if line.startswith("# Max Latencies"))
    return {"p50": percentile(counts, 0.5), "p99": percentile(counts, 0.99), "max": float(highest.split()[-1])}


def percentile(counts: list[tuple[int, int]], fraction: float) -> float:
    wanted = fraction * sum(count for _, count in counts)
    seen = 0
    for delay_us, count in counts:
        seen += count
        if seen >= wanted:
            return float(delay_us)
    return float(HISTOGRAM_US)


def trocar(args: argparse.Namespace) -> dict[str, float]:
    """The same of a simulated arm that holds still: the control thread ticks, filters and verifies all the same."""
    with tempfile.TemporaryDirectory() as folder:
        result = Path(folder) / "run.json"
        command = [args.trocar, "run", "--task", "needle-lift", "--policy", "noop", "--json", str(result)]
        command += ["--set", f"scene.episode.time_limit_s={args.seconds}"]
        if args.idle_states:
            command += ["--set", "realtime.hold_cpu_dma_latency=false"]
        if args.no_fifo:
            command += ["--set", "realtime.control.priority=0", "--set", "realtime.simulation.priority=0"]
        if args.cpu is not None:
            command += ["--set", f"realtime.control.cpu={args.cpu}"]
        subprocess.run(command, check=False, capture_output=True)
        real_time = json.loads(result.read_text())["real_time"]
        fifo = real_time["thread"]["granted"]["fifo"]
        if not args.no_fifo and fifo != "granted":
            sys.exit(f"SCHED_FIFO is not granted: {fifo}")
        return real_time["wake_us"]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--trocar", default="target/release/trocar")
    parser.add_argument("--rounds", type=int, default=7)
    parser.add_argument("--seconds", type=int, default=5)
    parser.add_argument("--busy", type=int, default=0)
    parser.add_argument("--no-fifo", action="store_true")
    parser.add_argument("--cpu", type=int)
    parser.add_argument("--idle-states", action="store_true")
    args = parser.parse_args()
    busy = [subprocess.Popen(["sha256sum", "/dev/zero"], stdout=subprocess.DEVNULL) for _ in range(args.busy)]
    try:
        rounds = []
        for index in range(args.rounds):
            both = cyclictest(args), trocar(args)
            rounds.append(both)
            for name, delays in zip(("cyclictest", "trocar"), both, strict=True):
                print(f"{index + 1}  {name:10}  p50 {delays['p50']:6.0f}  p99 {delays['p99']:6.0f}  max {delays['max']:6.0f}")
    finally:
        for process in busy:
            process.kill()
    for key in ("p50", "p99", "max"):
        theirs, ours = (statistics.median(both[side][key] for both in rounds) for side in (0, 1))
        print(f"median {key}: cyclictest {theirs:.0f} us, trocar {ours:.0f} us, ratio {ours / theirs:.2f}")


if __name__ == "__main__":
    main()
