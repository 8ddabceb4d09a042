#!/usr/bin/env python3
"""The fault matrix as one Markdown table, of the rows that tests have kept in target/scratch/fault-matrix.

    make test-clocked                         faults of simulated runs and of a robot's cameras
    make test-can                             those over CAN
    tests/scripts/fault_matrix.py [--write]   prints the table; --write puts it into runtime/SAFETY.md

Exit code 1 if a row is missing, or older than the program that tests run; the table then has none for it.
"""

import argparse
import sys
from pathlib import Path

ROWS = """
policy-killed policy-hangs policy-killed-last cameras-killed cameras-hang cameras-killed-last cameras-killed-log
policy-leaves policy-elsewhere policy-another policy-other-arms policy-other-camera policy-malformed policy-version policy-changed
world-another world-seed world-scene cameras-scene cameras-scene-later
chunks-nan chunks-old chunks-late stopped-20-ms stopped-400-ms overruns fault-cleared signal-TERM signal-INT disk-full disk-stands
camera-freezes camera-repeats camera-grows camera-killed can-policy-killed can-camera-killed can-clock-jumps
""".split()
HEAD = "| fault | seen as | detected after, ticks | then at rest after, ticks | limits | then |\n|---|---|---|---|---|---|\n"
ROOT = Path(__file__).parents[2]


def put_into(document: Path, table: str) -> None:
    """Replaces the table of `document` that begins as ours does."""
    lines = document.read_text().splitlines(keepends=True)
    begin = next(at for at, line in enumerate(lines) if line.startswith("| fault | seen as |"))
    end = next(at for at in range(begin, len(lines)) if not lines[at].startswith("|"))
    document.write_text("".join([*lines[:begin], table, *lines[end:]]))


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--write", action="store_true")
    args = parser.parse_args()
    kept = ROOT / "target/scratch/fault-matrix"
    built = (ROOT / "target/checked/trocar").stat().st_mtime
    missing = [name for name in ROWS if not (kept / name).is_file() or (kept / name).stat().st_mtime < built]
    table = HEAD + "".join((kept / name).read_text() for name in ROWS if name not in missing)
    print(table, end="")
    if missing:
        print(f"no row of this program in {kept}: {', '.join(missing)}", file=sys.stderr)
        return 1
    if args.write:
        put_into(ROOT / "runtime/SAFETY.md", table)
    return 0


if __name__ == "__main__":
    sys.exit(main())
