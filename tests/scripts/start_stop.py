#!/usr/bin/env python3
"""How long a run in real time takes from its start to the arm's first motion, and from a signal to its end, the arm at rest in between.

    tests/scripts/start_stop.py [--trocar target/release/trocar] [--task needle-lift] [--policy POLICY] [--rounds 7]

Asks the run's operator's socket every millisecond whether the arm moves, as `trocar status` does. The first round reads the weights from disk and
is left out. SIGINT comes 1.5 s after the first motion. Prints each round and the medians.
"""

import argparse
import json
import os
import signal
import socket
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

POLICIES = ["random", "config/policies/needle-lift/act-compact"]
MOVES_FOR_S = 1.5


def runs_folder() -> Path:
    base = Path(os.environ.get("XDG_RUNTIME_DIR", "/tmp"))
    return (base if base.is_dir() else Path("/tmp")) / f"trocar-{os.getuid()}"


def status(process: int) -> dict | None:
    """What the run says of its arms, or None if it does not listen yet."""
    with socket.socket(socket.AF_UNIX) as run:
        try:
            run.connect(str(runs_folder() / f"run-{process}.sock"))
            run.sendall(b"status json\n")
            return json.loads(run.makefile().readline())
        except (FileNotFoundError, ConnectionError, json.JSONDecodeError):
            return None


def moves(process: int) -> bool:
    found = status(process)
    return found is not None and any(arm["state"] == "ENABLED" and arm["busy"] for arm in found["arms"])


def one_round(args: argparse.Namespace, policy: str) -> tuple[float, float]:
    """Seconds from the start to the first motion, and from the signal to the end."""
    with tempfile.TemporaryDirectory() as folder:
        result = Path(folder) / "run.json"
        command = [args.trocar, "run", "--task", args.task, "--policy", policy, "--seed", "1", "--json", str(result)]
        began = time.monotonic()
        run = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        while not moves(run.pid):
            if run.poll() is not None:
                sys.exit(f"{policy}: the run ended with {run.returncode} before the arm moved")
            time.sleep(0.001)
        moved = time.monotonic()
        time.sleep(MOVES_FOR_S)
        told = time.monotonic()
        run.send_signal(signal.SIGINT)
        run.wait()
        ended = time.monotonic()
        reason = json.loads(result.read_text())["reason"]
        if reason != "interrupted":
            sys.exit(f"{policy}: {reason}")
    return moved - began, ended - told


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--trocar", default="target/release/trocar")
    parser.add_argument("--task", default="needle-lift")
    parser.add_argument("--policy", action="append")
    parser.add_argument("--rounds", type=int, default=7)
    args = parser.parse_args()
    for policy in args.policy or POLICIES:
        one_round(args, policy)
        times = [one_round(args, policy) for _ in range(args.rounds)]
        for start_s, stop_s in times:
            print(f"{policy}  start to first motion {start_s:.2f} s, stop to exit {stop_s:.2f} s", flush=True)
        starts, stops = zip(*times, strict=True)
        print(f"{policy}  medians {statistics.median(starts):.2f} s, {statistics.median(stops):.2f} s; most {max(starts):.2f} s, {max(stops):.2f} s")


if __name__ == "__main__":
    main()
