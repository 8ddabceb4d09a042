#!/usr/bin/env python3
"""Training throughput of ACT beside LeRobot's trainer: the same network, the same batch, samples a second.

    trocar record --task needle-lift --episodes 10 --cameras single --out runs/throughput
    TORCH_ALLOW_TF32_CUBLAS_OVERRIDE=1 python3 tests/scripts/training_peers.py \\
        --trocar target/release/trocar --data runs/throughput --preset lerobot --batch 8 --steps 200 --device cuda

Requirements: torch (Python 3.10 or newer); with lerobot==0.6.1 installed the peer is LeRobot's own `ACTPolicy` under the
step of its trainer, and otherwise a plain PyTorch ACT of the same operations, written here; the output says which. The plain
one has what LeRobot's has: eager layers, attention that asks for its weights, AdamW, a gradient clipped to norm 10, the
loss read at every step, TF32 and cuDNN's benchmark on.

Both get their images as bytes that lie ready where they are computed (the peer from one fixed pool of random frames), so that
decoding, which differs for other reasons, is left out: LeRobot decodes frames in every step. `--loader` adds a row with
LeRobot's own dataset and DataLoader (4 workers, its default) on the same folder.

What is the same: sizes of the preset, number of cameras, batch, frames' size, precision (TF32 for the matrix products of
trocar needs the variable above; on a CPU there is none). What differs and cannot be helped: LeRobot normalises in the
backbone with frozen statistics, trocar trains GroupNorm; `--norm group` (the default of the plain peer) makes them equal.
The numbers of parameters are compared with those of the checkpoint that trocar writes.
"""

import argparse
import json
import math
import os
import struct
import subprocess
import sys
import tempfile
import time

import torch
from torch import nn
from torch.nn import functional as F

PRESETS = {
    # chunk, width, heads, feed-forward, encoder layers, built decoder layers, image side
    "small": (50, 256, 8, 1024, 4, 1, 256),
    "lerobot": (100, 512, 8, 3200, 4, 1, 512),
    "paper": (100, 512, 8, 3200, 4, 1, 512),
}
LATENT = 32
VAE_LAYERS = 4


class FrozenNorm(nn.Module):
    def __init__(self, channels):
        super().__init__()
        for name, value in (("weight", 1.0), ("bias", 0.0), ("running_mean", 0.0), ("running_var", 1.0)):
            self.register_buffer(name, torch.full((channels,), value))

    def forward(self, x):
        scale = self.weight * (self.running_var + 1e-5).rsqrt()
        shift = self.bias - self.running_mean * scale
        return x * scale[None, :, None, None] + shift[None, :, None, None]


def norm_of(kind, channels):
    return nn.GroupNorm(channels // 16, channels) if kind == "group" else FrozenNorm(channels)


class Block(nn.Module):
    def __init__(self, inputs, outputs, stride, norm):
        super().__init__()
        self.conv1 = nn.Conv2d(inputs, outputs, 3, stride, 1, bias=False)
        self.bn1 = norm_of(norm, outputs)
        self.conv2 = nn.Conv2d(outputs, outputs, 3, 1, 1, bias=False)
        self.bn2 = norm_of(norm, outputs)
        self.down = None
        if stride != 1:
            self.down = nn.Sequential(nn.Conv2d(inputs, outputs, 1, stride, bias=False), norm_of(norm, outputs))

    def forward(self, x):
        y = F.relu(self.bn1(self.conv1(x)))
        y = self.bn2(self.conv2(y))
        return F.relu(y + (x if self.down is None else self.down(x)))


class ResNet18(nn.Module):
    def __init__(self, norm):
        super().__init__()
        self.stem = nn.Conv2d(3, 64, 7, 2, 3, bias=False)
        self.bn = norm_of(norm, 64)
        blocks, inputs = [], 64
        for stage, outputs in enumerate((64, 128, 256, 512)):
            for index in range(2):
                blocks.append(Block(inputs, outputs, 2 if stage and not index else 1, norm))
                inputs = outputs
        self.blocks = nn.Sequential(*blocks)

    def forward(self, x):
        return self.blocks(F.max_pool2d(F.relu(self.bn(self.stem(x))), 3, 2, 1))


class EncoderLayer(nn.Module):
    def __init__(self, width, heads, hidden):
        super().__init__()
        self.attention = nn.MultiheadAttention(width, heads, dropout=0.1)
        self.wide, self.narrow = nn.Linear(width, hidden), nn.Linear(hidden, width)
        self.norm1, self.norm2 = nn.LayerNorm(width), nn.LayerNorm(width)
        self.drop, self.drop1, self.drop2 = nn.Dropout(0.1), nn.Dropout(0.1), nn.Dropout(0.1)

    def forward(self, x, position, padding=None):
        q = x + position
        x = self.norm1(x + self.drop1(self.attention(q, q, value=x, key_padding_mask=padding)[0]))
        return self.norm2(x + self.drop2(self.narrow(self.drop(F.relu(self.wide(x))))))


class DecoderLayer(nn.Module):
    def __init__(self, width, heads, hidden):
        super().__init__()
        self.own = nn.MultiheadAttention(width, heads, dropout=0.1)
        self.cross = nn.MultiheadAttention(width, heads, dropout=0.1)
        self.wide, self.narrow = nn.Linear(width, hidden), nn.Linear(hidden, width)
        self.norms = nn.ModuleList(nn.LayerNorm(width) for _ in range(3))
        self.drops = nn.ModuleList(nn.Dropout(0.1) for _ in range(4))

    def forward(self, x, memory, queries, position):
        q = x + queries
        x = self.norms[0](x + self.drops[0](self.own(q, q, value=x)[0]))
        cross = self.cross(query=x + queries, key=memory + position, value=memory)[0]
        x = self.norms[1](x + self.drops[1](cross))
        return self.norms[2](x + self.drops[2](self.narrow(self.drops[3](F.relu(self.wide(x))))))


def plane(side, width):
    turn = torch.arange(1, side + 1) / (side + 1e-6) * 2 * math.pi
    frequency = 10000 ** (2 * (torch.arange(width // 2) // 2) / (width // 2))
    angles = turn[:, None] / frequency
    table = torch.stack((angles[:, 0::2].sin(), angles[:, 1::2].cos()), -1).flatten(1)
    rows, columns = table[:, None].expand(-1, side, -1), table[None].expand(side, -1, -1)
    return torch.cat((rows, columns), -1).flatten(0, 1)


class PlainAct(nn.Module):
    """ACT with LeRobot's operations."""

    def __init__(self, preset, state, action, norm):
        super().__init__()
        chunk, width, heads, hidden, layers, decoders, side = PRESETS[preset]
        self.backbone = ResNet18(norm)
        self.image = nn.Conv2d(512, width, 1)
        self.state, self.latent = nn.Linear(state, width), nn.Linear(LATENT, width)
        self.tokens, self.queries = nn.Embedding(2, width), nn.Embedding(chunk, width)
        self.encoder = nn.ModuleList(EncoderLayer(width, heads, hidden) for _ in range(layers))
        self.decoder = nn.ModuleList(DecoderLayer(width, heads, hidden) for _ in range(decoders))
        self.norm, self.head = nn.LayerNorm(width), nn.Linear(width, action)
        self.vae = nn.ModuleDict(
            {
                "class": nn.Embedding(1, width),
                "state": nn.Linear(state, width),
                "action": nn.Linear(action, width),
                "out": nn.Linear(width, 2 * LATENT),
                "layers": nn.ModuleList(EncoderLayer(width, heads, hidden) for _ in range(VAE_LAYERS)),
            }
        )
        angles = torch.arange(chunk + 2)[:, None] / 10000 ** (2 * (torch.arange(width) // 2) / width)
        table = torch.where(torch.arange(width) % 2 == 0, angles.sin(), angles.cos())
        self.register_buffer("sequence", table[:, None])
        self.register_buffer("plane", plane(math.ceil(side / 32), width)[:, None])

    def forward(self, images, state, actions, padded):
        batch, cameras = images.shape[:2]
        vae = self.vae
        class_token = vae["class"].weight[None].expand(batch, -1, -1)
        x = torch.cat((class_token, vae["state"](state)[:, None], vae["action"](actions)), 1).transpose(0, 1)
        always = torch.zeros(batch, 2, dtype=torch.bool, device=state.device)
        for layer in vae["layers"]:
            x = layer(x, self.sequence, torch.cat((always, padded), 1))
        mean, log_variance = vae["out"](x[0]).chunk(2, -1)
        latent = mean + (log_variance / 2).exp() * torch.randn_like(mean)
        tokens, positions = [self.latent(latent)[None], self.state(state)[None]], [self.tokens.weight[:, None]]
        for camera in range(cameras):
            features = self.image(self.backbone(images[:, camera]))
            tokens.append(features.flatten(2).permute(2, 0, 1))
            positions.append(self.plane)
        x, position = torch.cat(tokens), torch.cat(positions)
        for layer in self.encoder:
            x = layer(x, position)
        queries = self.queries.weight[:, None]
        y = torch.zeros_like(queries).expand(-1, batch, -1)
        for layer in self.decoder:
            y = layer(y, x, queries, position)
        predicted = self.head(self.norm(y)).transpose(0, 1)
        error = (F.l1_loss(predicted, actions, reduction="none") * ~padded[..., None]).sum()
        l1 = error / ((~padded).sum() * actions.shape[-1]).clamp(min=1)
        kl = (-0.5 * (1 + log_variance - mean.pow(2) - log_variance.exp())).sum(-1).mean()
        return l1 + 10 * kl


def lerobot_policy(preset, cameras, state, action, side):
    from lerobot.configs.types import FeatureType, PolicyFeature
    from lerobot.policies.act.configuration_act import ACTConfig
    from lerobot.policies.act.modeling_act import ACTPolicy

    chunk, width, heads, hidden, layers, decoders, _ = PRESETS[preset]
    inputs = {name: PolicyFeature(FeatureType.VISUAL, (3, side, side)) for name in cameras}
    inputs["observation.state"] = PolicyFeature(FeatureType.STATE, (state,))
    config = ACTConfig(
        input_features=inputs,
        output_features={"action": PolicyFeature(FeatureType.ACTION, (action,))},
        chunk_size=chunk,
        n_action_steps=chunk,
        dim_model=width,
        n_heads=heads,
        dim_feedforward=hidden,
        n_encoder_layers=layers,
        n_decoder_layers=decoders,
        pretrained_backbone_weights=None,
        device="cpu",
    )
    return ACTPolicy(config)


class Pool:
    """Frames that lie ready; a batch is normalised on the way, as by both trainers."""

    def __init__(self, args, info, device):
        chunk = PRESETS[args.preset][0]
        side = PRESETS[args.preset][6]
        frames = 4 * args.batch
        shape = (frames, len(info["cameras"]), side, side, 3)
        self.images = torch.randint(0, 256, shape, dtype=torch.uint8, device=device)
        self.state = torch.randn(frames, info["state"], device=device)
        self.actions = torch.randn(frames, chunk, info["action"], device=device)
        self.padded = torch.zeros(frames, chunk, dtype=torch.bool, device=device)
        self.mean = torch.tensor([0.485, 0.456, 0.406], device=device).view(3, 1, 1)
        self.std = torch.tensor([0.229, 0.224, 0.225], device=device).view(3, 1, 1)
        self.frames, self.batch, self.device = frames, args.batch, device

    def draw(self):
        chosen = torch.randint(0, self.frames, (self.batch,), device=self.device)
        images = self.images[chosen].movedim(-1, -3).float() / 255
        images = (images - self.mean) / self.std
        return images, self.state[chosen], self.actions[chosen], self.padded[chosen]


def info_of(data):
    with open(os.path.join(data, "meta", "info.json"), encoding="utf-8") as file:
        features = json.load(file)["features"]
    cameras = [name for name in features if name.startswith("observation.images.")]
    # trocar trains on seven numbers an arm: relative translation, rotation vector, jaw.
    state = math.prod(features["observation.state"]["shape"])
    return {"cameras": cameras, "state": state, "action": state}


def waited(device):
    if device.type == "cuda":
        torch.cuda.synchronize()
    return time.perf_counter()


def timed(step, steps, batch, device):
    for _ in range(max(steps // 10, 2)):
        step()
    begun = waited(device)
    for _ in range(steps):
        step()
    return steps * batch / (waited(device) - begun)


def optimised(module, backbone, bf16, forward):
    """The step of LeRobot's trainer around `forward`."""
    rest = [p for name, p in module.named_parameters() if backbone not in name and p.requires_grad]
    first = [p for name, p in module.named_parameters() if backbone in name and p.requires_grad]
    groups = [{"params": rest}, {"params": first, "lr": 1e-5}]
    optimiser = torch.optim.AdamW(groups, lr=1e-5, weight_decay=1e-4)
    device = next(module.parameters()).device

    def step():
        with torch.autocast(device.type, torch.bfloat16, enabled=bf16):
            loss = forward()
        loss.backward()
        torch.nn.utils.clip_grad_norm_(module.parameters(), 10.0)
        optimiser.step()
        optimiser.zero_grad()
        return loss.item()

    return step


def peer_rows(args, info, device):
    side = PRESETS[args.preset][6]
    pool = Pool(args, info, device)
    rows = []
    plain = PlainAct(args.preset, info["state"], info["action"], args.norm).to(device).train()
    count = sum(p.numel() for p in plain.parameters())
    inference = count - sum(p.numel() for p in plain.vae.parameters())
    step = optimised(plain, "backbone", args.bf16, lambda: plain(*pool.draw()))
    rows.append((f"plain PyTorch ACT, {args.norm} norm, frames ready", timed(step, args.steps, args.batch, device)))
    del plain, step
    try:
        policy = lerobot_policy(args.preset, info["cameras"], info["state"], info["action"], side)
    except ImportError as missing:
        print(f"LeRobot is not installed ({missing}): its operations in plain PyTorch stand in for it")
        return rows, inference
    policy = policy.to(device).train()
    policy.config.device = str(device)

    def forward(batch=None):
        if batch is None:
            images, state, actions, padded = pool.draw()
            batch = {"observation.state": state, "action": actions, "action_is_pad": padded}
            batch |= {name: images[:, index] for index, name in enumerate(info["cameras"])}
        return policy.forward(batch)[0]

    step = optimised(policy, "model.backbone", args.bf16, forward)
    rows.append(("LeRobot's ACTPolicy, frames ready", timed(step, args.steps, args.batch, device)))
    if args.loader:
        batches = loaded(args, info, device)
        loader_step = optimised(policy, "model.backbone", args.bf16, lambda: forward(next(batches)))
        rows.append(("LeRobot's ACTPolicy, its dataset and loader", timed(loader_step, args.steps, args.batch, device)))
    return rows, inference


def loaded(args, info, device):
    """Batches of LeRobot's own loader, shrunk to the network's size on the device."""
    from lerobot.datasets.lerobot_dataset import LeRobotDataset

    chunk, side = PRESETS[args.preset][0], PRESETS[args.preset][6]
    with open(os.path.join(args.data, "meta", "info.json"), encoding="utf-8") as file:
        fps = json.load(file)["fps"]
    times = {"action": [step / fps for step in range(chunk)]}
    dataset = LeRobotDataset("throughput/throughput", root=args.data, delta_timestamps=times)
    loader = torch.utils.data.DataLoader(
        dataset, batch_size=args.batch, shuffle=True, num_workers=4, pin_memory=True, drop_last=True
    )
    while True:
        for batch in loader:
            batch = {key: value.to(device, non_blocking=True) for key, value in batch.items() if torch.is_tensor(value)}
            for name in info["cameras"]:
                if batch[name].shape[-1] != side:
                    batch[name] = F.interpolate(batch[name], (side, side), mode="area")
            # Absolute poses stand in for relative ones of as many numbers.
            batch["action"] = batch["action"].flatten(2)[..., : info["action"]].float()
            batch["observation.state"] = batch["observation.state"].flatten(1).float()
            yield batch


def elements(file):
    """Numbers in a safetensors file, by its header."""
    with open(file, "rb") as stream:
        header = json.loads(stream.read(struct.unpack("<Q", stream.read(8))[0]))
    shapes = [entry["shape"] for key, entry in header.items() if key != "__metadata__"]
    return sum(math.prod(shape) for shape in shapes)


def ours(args):
    with tempfile.TemporaryDirectory() as folder:
        out, result = os.path.join(folder, "act"), os.path.join(folder, "result.json")
        # Rows of the loss curve are every 50 steps, and the rate is counted from the first.
        steps = 50 * max(math.ceil(args.steps / 50), 1) + 50
        command = [args.trocar, "train", "--policy", "act", "--data", args.data, "--out", out]
        command += ["--preset", args.preset, "--batch", str(args.batch), "--steps", str(steps)]
        command += ["--device", args.device, "--threads", str(args.threads), "--save-every", "0", "--json", result]
        if args.bf16:
            command.append("--bf16")
        subprocess.run(command, check=True, stderr=subprocess.DEVNULL, stdout=subprocess.DEVNULL)
        with open(result, encoding="utf-8") as file:
            rate = json.load(file)["samples_per_second"]
        return rate, elements(os.path.join(out, "model.safetensors"))


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--trocar", default="target/release/trocar")
    parser.add_argument("--data", required=True, help="a dataset recorded by trocar")
    parser.add_argument("--preset", choices=sorted(PRESETS), default="lerobot")
    parser.add_argument("--batch", type=int, default=8)
    parser.add_argument("--steps", type=int, default=200)
    parser.add_argument("--device", choices=["cpu", "cuda"], default="cpu")
    parser.add_argument("--threads", type=int, default=torch.get_num_threads())
    parser.add_argument("--norm", choices=["group", "frozen"], default="group")
    parser.add_argument("--bf16", action="store_true")
    parser.add_argument("--loader", action="store_true", help="LeRobot with its dataset and loader too")
    args = parser.parse_args()
    torch.set_num_threads(args.threads)
    torch.backends.cudnn.benchmark = True
    torch.backends.cuda.matmul.allow_tf32 = True
    device = torch.device(args.device)
    info = info_of(args.data)
    print(
        f"ACT {args.preset}, {len(info['cameras'])} cameras, batch {args.batch}, "
        f"{'bf16' if args.bf16 else 'float32'}, {args.device}, torch {torch.__version__}, {args.threads} threads"
    )
    rate, stored = ours(args)
    rows, inference = peer_rows(args, info, device)
    # Weights and biases of the normalisations, 4800 channels in all, are no parameters of a frozen peer.
    frozen = 0 if args.norm == "group" else 2 * 4800
    if stored != inference + frozen:
        sys.exit(f"not the same network: {stored} numbers in trocar's checkpoint, {inference} in the peer's")
    print(f"{stored} parameters at inference in both")
    print(f"{rate:9.1f} samples/s  trocar")
    for name, peer in rows:
        print(f"{peer:9.1f} samples/s  {name} (trocar is {rate / peer:.2f} times as fast)")


if __name__ == "__main__":
    main()
