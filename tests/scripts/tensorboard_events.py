#!/usr/bin/env python3
"""TensorBoard's own reader against what a training wrote beside it.

    trocar train --policy act --data runs/demos --out runs/act --steps 200 --eval-every 100
    python3 tests/scripts/tensorboard_events.py runs/act

Reads the event files of the folder with `EventAccumulator` of the package `tensorboard` and compares every number with `loss.csv`
and, if there is one, `evaluations.csv`: the same steps, the same values in single precision. A training that was interrupted and
resumed has several event files; what the tables have only once must be shown only once.

Requirements: tensorboard and setuptools.
"""

import argparse
import csv
import pathlib
import struct
import sys

from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

# Column of the table, tag in the event files.
LOSSES = {
    "loss": "train/loss",
    "l1": "train/l1",
    "kl": "train/kl",
    "gradient_norm": "train/gradient_norm",
    "lr": "train/learning_rate",
    "validation_l1": "validation/l1",
}
EVALUATIONS = {"rate": "evaluation/success_rate"}


def single(number):
    return struct.unpack("f", struct.pack("f", float(number)))[0]


def compare(table, columns, events):
    rows = list(csv.DictReader(table.open()))
    for column, tag in columns.items():
        expected = [(int(row["step"]), single(row[column])) for row in rows if row[column]]
        known = tag in events.Tags()["scalars"]
        found = [(event.step, event.value) for event in events.Scalars(tag)] if known else []
        if found != expected:
            sys.exit(f"{table}: {column} has {expected}, the event files have {found}")
        print(f"{tag}: {len(found)} values, the same as {column} in {table.name}")


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=pathlib.Path, help="the output folder of a training")
    folder = parser.parse_args().folder
    # 0 keeps all values.
    events = EventAccumulator(str(folder), size_guidance={"scalars": 0})
    events.Reload()
    compare(folder / "loss.csv", LOSSES, events)
    evaluations = folder / "evaluations.csv"
    if evaluations.is_file():
        compare(evaluations, EVALUATIONS, events)
    rates = [event.value for event in events.Scalars("train/samples_per_second")]
    if not rates or min(rates) <= 0:
        sys.exit(f"samples a second: {rates}")


if __name__ == "__main__":
    main()
