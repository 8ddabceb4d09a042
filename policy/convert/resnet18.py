#!/usr/bin/env python3
"""torchvision's ResNet-18, trained on ImageNet, into what `trocar train --backbone-weights` reads. Once; it downloads 45 MB.

Requirements: torch torchvision safetensors

    python policy/convert/resnet18.py resnet18.safetensors [--weights FILE.pth]

`--weights` names a file of torchvision's that is already there, which is read without running what is in it.
"""

import argparse
import sys

import torch
from safetensors.torch import save_file

# The first and the last tensor of the backbone.
ENDS = ["conv1.weight", "layer4.1.bn2.running_var"]


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", help="the safetensors file to write")
    parser.add_argument("--weights", help="torchvision's file, instead of a download")
    options = parser.parse_args()
    if options.weights:
        state = torch.load(options.weights, map_location="cpu", weights_only=True)
        if not isinstance(state, dict) or not all(isinstance(state.get(key), torch.Tensor) for key in ENDS):
            sys.exit(f"{options.weights} is not torchvision's ResNet-18: {' and '.join(ENDS)} are not both there")
    else:
        from torchvision.models import ResNet18_Weights, resnet18

        state = resnet18(weights=ResNet18_Weights.IMAGENET1K_V1).state_dict()
    wanted = {
        key: value.contiguous()
        for key, value in state.items()
        if not key.startswith("fc.") and not key.endswith("num_batches_tracked")
    }
    save_file(wanted, options.out)
    print(f"{len(wanted)} tensors in {options.out}")


if __name__ == "__main__":
    main()
