#!/usr/bin/env python3
"""MONAI's UNet as TorchScript, and what MONAI's sliding window makes of it, to hold `trocar_nets::segmenter` to.

    pip install torch==2.11.0 monai==1.5.1
    python tests/scripts/segmenter_golden.py tests/golden      # what is committed
    python tests/scripts/segmenter_golden.py --channels 16,32,64 --strides 2,2 target/scratch/unet   # a larger one
    TROCAR_SEGMENTER=target/scratch/unet cargo test -p trocar-nets --lib segmenter

Into the given folder go segmenter.ts, exported as MONAI's bundles are (`torch.jit.script`), and segmenter.json: cases with every 199th
of the averaged scores. The volume is a formula that the test has as well.
"""

import argparse
import json
import zipfile
from pathlib import Path

import numpy as np
import torch
from monai.inferers import sliding_window_inference
from monai.networks.nets import UNet

CLASSES = 5
WINDOW_HU = (-500.0, 600.0)
# dims, patch, overlap, mode; a volume as large as a window, several windows, windows that are larger than the volume.
CASES = [
    ((16, 24, 16), (16, 24, 16), 0.25, "gaussian"),
    ((29, 34, 27), (16, 16, 16), 0.25, "gaussian"),
    ((29, 34, 27), (16, 24, 8), 0.5, "constant"),
    ((13, 20, 40), (16, 16, 16), 0.7, "gaussian"),
]
STRIDE = 199


def volume(dims):
    x, y, z = np.meshgrid(*(np.arange(side, dtype=np.float64) for side in dims), indexing="ij")
    hounsfield = 500.0 * np.sin(0.37 * x + 0.11 * y) + 300.0 * np.cos(0.23 * z - 0.013 * x * y)
    return torch.from_numpy(hounsfield.astype(np.float32))


def whole_numbers(text):
    return tuple(int(word) for word in text.split(","))


def export(network, path):
    """Writes the script without its debug records, which name source files of this machine."""
    torch.jit.script(network).save(str(path))
    with zipfile.ZipFile(path) as whole:
        records = [(record, whole.read(record)) for record in whole.infolist() if not record.filename.endswith(".debug_pkl")]
    with zipfile.ZipFile(path, "w") as kept:
        for record, data in records:
            kept.writestr(zipfile.ZipInfo(record.filename), data, record.compress_type)
    torch.jit.load(str(path))


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--channels", type=whole_numbers, default=(4, 8, 16))
    parser.add_argument("--strides", type=whole_numbers, default=(2, 2))
    options = parser.parse_args()
    options.folder.mkdir(parents=True, exist_ok=True)
    torch.manual_seed(3)
    network = UNet(3, 1, CLASSES, options.channels, options.strides, num_res_units=2).eval()
    export(network, options.folder / "segmenter.ts")
    low, high = WINDOW_HU
    cases = []
    for dims, patch, overlap, mode in CASES:
        seen = ((volume(dims) - low) / (high - low)).clamp(0, 1)[None, None]
        with torch.no_grad():
            scores = sliding_window_inference(seen, patch, 1, network, overlap, mode)[0]
        cases.append(
            {
                "dims": dims,
                "patch": patch,
                "overlap": overlap,
                "weighting": mode,
                "scores": [float(f"{value:.8g}") for value in scores.flatten()[::STRIDE]],
            }
        )
    text = {"classes": CLASSES, "window_hu": WINDOW_HU, "stride": STRIDE, "cases": cases}
    (options.folder / "segmenter.json").write_text(json.dumps(text) + "\n")


if __name__ == "__main__":
    main()
