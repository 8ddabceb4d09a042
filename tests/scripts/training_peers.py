#!/usr/bin/env python3
"""Training throughput of ACT beside LeRobot's trainer: the same network, the same batch, samples a second.

    trocar record --task needle-lift --episodes 2 --cameras single --out runs/throughput
    python3 tests/scripts/training_peers.py --trocar target/release/trocar --data runs/throughput \\
        --preset lerobot --batch 8 --device cuda

Requirements: torch and torchvision (Python 3.10 or newer). With lerobot==0.6.1 (Python 3.12; `lerobot_trainer.py` beside this names
what it needs) the peer is LeRobot's own trainer: its `ACTPolicy`, its optimiser, its processors, `update_policy` and accelerate.
Otherwise, or besides with `--plain`, it is a plain PyTorch ACT of the same operations, written here, under the same step: eager
layers, attention that asks for its weights, AdamW, a gradient clipped to norm 10, the loss read at every step, TF32 and cuDNN's
benchmark on. The output says which.

Both precisions are compared, one after the other: single precision with TF32 for matrix products and convolutions on CUDA, set for
both sides, and bfloat16, trocar's by `--bf16`, the peer's by its own mixed precision (LeRobot's is accelerate's). On CUDA trocar
takes its steps recorded, as it does by itself; `--eager` adds a row with steps that the device is told piece by piece.

The sides take turns, `--rounds` times. Each gets its images as bytes that lie ready where it computes (the peer from one fixed
pool of random frames), so that decoding, which differs for other reasons, is left out: LeRobot decodes frames in every step.
`--loader` adds a row with LeRobot's own dataset and DataLoader (4 workers, its default) on the same folder. Each side's first
steps are not timed: 50 of trocar's, a fifth of the peer's.

What is the same: sizes of the preset, number of cameras, batch, frames' size, and with `--norm frozen` every tensor of the
checkpoint: LeRobot's backbone has frozen statistics, here those of random weights and images. `--norm group` gives trocar and the
plain peer GroupNorm, which is trained, and which trocar's presets have. The numbers in the checkpoint that trocar writes are
counted and compared with the peer's. What is not the same: trocar's default recipe keeps a moving average of the weights besides.

On CUDA the output has the memory too: what `nvidia-smi` says of each process, of trocar's in a run of its own, and the most that the
peer's tensors took in a step. Both hold their frames there, trocar those of its dataset.
"""

import argparse
import functools
import gc
import json
import math
import os
import pathlib
import statistics
import struct
import subprocess
import sys
import tempfile
import threading
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


class Pool:
    """Frames that lie ready; a batch is normalised on the way, as in both trainers."""

    def __init__(self, args, info, device):
        chunk = PRESETS[args.preset][0]
        side = PRESETS[args.preset][6]
        frames = 4 * args.batch
        shape = (frames, len(info["cameras"]), 3, side, side)
        self.images = torch.randint(0, 256, shape, dtype=torch.uint8, device=device)
        self.state = torch.randn(frames, info["state"], device=device)
        self.actions = torch.randn(frames, chunk, info["action"], device=device)
        self.padded = torch.zeros(frames, chunk, dtype=torch.bool, device=device)
        self.mean = torch.tensor([0.485, 0.456, 0.406], device=device).view(3, 1, 1)
        self.std = torch.tensor([0.229, 0.224, 0.225], device=device).view(3, 1, 1)
        self.frames, self.batch, self.device = frames, args.batch, device

    def chosen(self):
        return torch.randint(0, self.frames, (self.batch,), device=self.device)

    def draw(self):
        chosen = self.chosen()
        images = (self.images[chosen].float() / 255 - self.mean) / self.std
        return images, self.state[chosen], self.actions[chosen], self.padded[chosen]

    def draw_for_lerobot(self, cameras):
        """As its loader gives them: by name, images in bytes."""
        chosen = self.chosen()
        batch = {"observation.state": self.state[chosen], "action": self.actions[chosen], "action_is_pad": self.padded[chosen]}
        return batch | {name: self.images[chosen, index] for index, name in enumerate(cameras)}


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
    for _ in range(max(steps // 4, 2)):
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


def plain_peer(args, bf16, info, device):
    """What to time, and how many numbers trocar's checkpoint of the same network has."""
    pool = Pool(args, info, device)
    module = PlainAct(args.preset, info["state"], info["action"], args.norm).to(device).train()
    count = sum(p.numel() for p in module.parameters())
    if args.norm == "group":
        # Kept for inference alone.
        count -= sum(p.numel() for p in module.vae.parameters())
    else:
        count += sum(b.numel() for b in module.buffers()) - module.plane.numel()
    step = optimised(module, "backbone", bf16, lambda: module(*pool.draw()))
    return {f"plain PyTorch ACT, {args.norm} norm": step}, count


def lerobot_peer(args, bf16, info, device, lerobot_trainer, backbone):
    pool = Pool(args, info, device)
    trainer = lerobot_trainer.Trainer(PRESETS[args.preset], info, backbone, args.batch, device, bf16)
    drawn = lambda: pool.draw_for_lerobot(info["cameras"])
    steps = {"LeRobot's trainer: processors and update": lambda: trainer.update(trainer.prepared(drawn()))}
    ready = trainer.prepared(drawn())
    steps["LeRobot's update alone, of one batch"] = lambda: trainer.update(ready)
    if args.loader:
        batches = loaded(args, info, device)
        steps["LeRobot's trainer with its dataset and loader"] = lambda: trainer.update(trainer.preprocessor(next(batches)))
    return steps, trainer.elements


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


def untrained_backbone():
    """ResNet-18 by torchvision's names, without its classifier: random weights, and the statistics of random images."""
    from torchvision.models import resnet18

    torch.manual_seed(0)
    network = resnet18(weights=None, norm_layer=functools.partial(nn.BatchNorm2d, momentum=1.0)).train()
    with torch.no_grad():
        network(torch.randn(4, 3, 128, 128))
    state = network.state_dict()
    return {key: value for key, value in state.items() if not key.startswith("fc.") and not key.endswith("num_batches_tracked")}


def environment_of_ours(device):
    environment = dict(os.environ)
    if device == "cuda":
        # As LeRobot's trainer allows it.
        environment["TORCH_ALLOW_TF32_CUBLAS_OVERRIDE"] = "1"
        # Built against a libtorch without CUDA, it runs on this one; the linker left out what is not named here.
        libraries = pathlib.Path(torch.__file__).parent / "lib"
        others = sorted(libraries.parent.parent.glob("nvidia/*/lib"))
        environment["LD_LIBRARY_PATH"] = ":".join(map(str, [libraries, *others]))
        environment["LD_PRELOAD"] = str(libraries / "libtorch_cuda.so")
    return environment


def asked_smi(query):
    """Rows of numbers; none if there is no nvidia-smi, or if it has no number to say."""
    command = ["nvidia-smi", query, "--format=csv,noheader,nounits"]
    try:
        lines = subprocess.run(command, capture_output=True, text=True, check=True).stdout.splitlines()
        return [[float(number) for number in line.split(",")] for line in lines]
    except (OSError, ValueError, subprocess.CalledProcessError):
        return []


def device_in_use():
    """MiB in use on the first device, whoever uses them."""
    rows = asked_smi("--query-gpu=memory.used")
    return rows[0][0] if rows else math.nan


def device_memory(process, before):
    """MiB that the device holds for a process; where it does not name processes, what it holds more than `before`."""
    named = {int(number): used for number, used in asked_smi("--query-compute-apps=pid,used_memory")}
    return named[process] if process in named else device_in_use() - before


class Memory:
    """The most that the device held for a process, MiB; looked at three times a second, since asking costs time too."""

    def __init__(self, process, before):
        self.most, self.ended = 0.0, threading.Event()
        self.thread = threading.Thread(target=self.watch, args=(process, before))
        self.thread.start()

    def watch(self, process, before):
        while not self.ended.wait(0.3):
            self.most = max(device_memory(process, before), self.most)

    def end(self):
        self.ended.set()
        self.thread.join()
        return self.most


def ours(args, how, backbone, watched=False):
    """Samples a second, the numbers in the checkpoint, and MiB on the device if it is watched and known; `how` are more options."""
    with tempfile.TemporaryDirectory() as folder:
        out, result = os.path.join(folder, "act"), os.path.join(folder, "result.json")
        # Rows of the loss curve are every 50 steps, and the rate is counted from the first. Whoever asks for the memory holds up
        # the device, so that a run that is watched is not timed.
        steps = 100 if watched else 50 * max(math.ceil(args.steps / 50), 1) + 50
        command = [args.trocar, "train", "--policy", "act", "--data", args.data, "--out", out]
        command += ["--preset", args.preset, "--batch", str(args.batch), "--steps", str(steps)]
        command += ["--device", args.device, "--threads", str(args.threads), "--save-every", "0", "--json", result]
        if args.episodes:
            command += ["--episodes", str(args.episodes)]
        if args.norm == "frozen":
            command += ["--backbone", "frozen_batch_norm", "--backbone-weights", backbone]
        command += how
        said = os.path.join(folder, "said.txt")
        before = device_in_use() if watched else math.nan
        with open(said, "w", encoding="utf-8") as stream:
            process = subprocess.Popen(command, stderr=stream, stdout=stream, env=environment_of_ours(args.device))
            memory = Memory(process.pid, before) if watched else None
            code = process.wait()
            most = memory.end() if memory else None
        if code:
            sys.exit(f"{' '.join(command)}: {code}: {pathlib.Path(said).read_text(encoding='utf-8')[-2000:]}")
        with open(result, encoding="utf-8") as file:
            rate = json.load(file)["samples_per_second"]
        return rate, elements(os.path.join(out, "model.safetensors")), most


def lerobot_or_why_not():
    try:
        import lerobot_trainer
    except Exception as error:  # noqa: BLE001 whatever is wrong with an installation, the plain peer stands in
        return None, f"LeRobot's trainer is not there ({type(error).__name__}: {error}): its operations in plain PyTorch stand in for it"
    aside = " and ".join(lerobot_trainer.SET_ASIDE)
    without = f", without {aside}, which no step uses (packages missing: {', '.join(lerobot_trainer.MISSING)})" if aside else ""
    return lerobot_trainer, f"LeRobot {lerobot_trainer.VERSION}, its own trainer's step{without}"


def peers(args, bf16, info, device, lerobot_trainer, backbone):
    """The peers' steps by their names; and the numbers of the network, by each that has the one that trocar trains."""
    steps, counts = {}, set()
    if lerobot_trainer:
        made, count = lerobot_peer(args, bf16, info, device, lerobot_trainer, backbone)
        steps |= made
        if args.norm == "frozen":
            counts.add(count)
    if args.plain or not lerobot_trainer:
        made, count = plain_peer(args, bf16, info, device)
        steps |= made
        counts.add(count)
    return steps, counts


def compare(args, bf16, info, lerobot_trainer, folder):
    """Rates of each side in one precision, and words on the memory of each."""
    device = torch.device(args.device)
    backbone = untrained_backbone() if args.norm == "frozen" or lerobot_trainer else None
    backbone_file = os.path.join(folder, "backbone.safetensors")
    if args.norm == "frozen":
        from safetensors.torch import save_file

        save_file(backbone, backbone_file)
    before = device_in_use() if args.device == "cuda" else math.nan
    steps, counts = peers(args, bf16, info, device, lerobot_trainer, backbone)
    precision = ["--bf16"] if bf16 else []
    own = {"trocar": precision}
    if args.eager:
        own["trocar --eager"] = [*precision, "--eager"]
    rates = {name: [] for name in [*own, *steps]}
    memory = {}
    begun = time.monotonic()
    for turn in range(args.rounds):
        if turn and args.seconds and (time.monotonic() - begun) * (turn + 1) / turn > args.seconds:
            print(f"no round {turn + 1}: it would take longer than {args.seconds:.0f} s")
            break
        watched = args.device == "cuda" and turn == 0
        for name, how in own.items():
            if watched:
                *_, used = ours(args, how, backbone_file, watched)
                memory[name] = f"{used:.0f} MiB of its process"
            rate, stored, _ = ours(args, how, backbone_file)
            if any(stored != count for count in counts):
                sys.exit(f"not the same network: {stored} numbers in trocar's checkpoint, {sorted(counts)} in the peers'")
            rates[name].append(rate)
        for name, step in steps.items():
            if watched:
                torch.cuda.reset_peak_memory_stats()
            rates[name].append(timed(step, args.steps, args.batch, device))
            if watched:
                most, process = torch.cuda.max_memory_allocated() / 2**20, device_memory(os.getpid(), before)
                memory[name] = f"{process:.0f} MiB of its process, {most:.0f} MiB of tensors"
        print(f"round {turn + 1}: " + ", ".join(f"{name} {values[-1]:.1f}" for name, values in rates.items()), flush=True)
    same = f"{stored} numbers in trocar's checkpoint"
    print(f"{same} and in the same network of a peer" if counts else f"{same}; LeRobot's backbone is another one")
    return rates, memory


def told(rates, memory):
    middle = statistics.median(rates["trocar"])
    for name, found in rates.items():
        rate = statistics.median(found)
        beside = "" if name == "trocar" else f"; trocar is {middle / rate:.2f} times as fast"
        used = f"; {memory[name]}" if name in memory else ""
        print(f"{rate:9.1f} samples/s ({min(found):.1f} to {max(found):.1f})  {name}{beside}{used}", flush=True)


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--trocar", default="target/release/trocar")
    parser.add_argument("--data", required=True, help="a dataset recorded by trocar")
    parser.add_argument("--episodes", type=int, help="its first episodes alone")
    parser.add_argument("--preset", choices=sorted(PRESETS), default="lerobot")
    parser.add_argument("--batch", type=int, default=8)
    parser.add_argument("--steps", type=int, default=200, help="timed steps a round; trocar's to the next 50, and more are better: it is quick")
    parser.add_argument("--rounds", type=int, default=3, help="turns of each side")
    parser.add_argument("--seconds", type=float, help="no further round that would end later, from the first one's start")
    parser.add_argument("--device", choices=["cpu", "cuda"], default="cpu")
    parser.add_argument("--threads", type=int, default=torch.get_num_threads())
    parser.add_argument("--norm", choices=["group", "frozen"], help="frozen with LeRobot, group without, if not given")
    parser.add_argument(
        "--precision", choices=["float32", "bfloat16", "both"], default="both", help="on the CPU both is float32 alone"
    )
    parser.add_argument("--eager", action="store_true", help="on CUDA, a row with trocar's steps told piece by piece")
    parser.add_argument("--plain", action="store_true", help="plain PyTorch beside LeRobot")
    parser.add_argument("--loader", action="store_true", help="LeRobot with its dataset and loader too")
    args = parser.parse_args()
    torch.set_num_threads(args.threads)
    torch.backends.cudnn.benchmark = True
    torch.backends.cuda.matmul.allow_tf32 = True
    lerobot_trainer, which = lerobot_or_why_not()
    if args.loader and (not lerobot_trainer or lerobot_trainer.SET_ASIDE):
        sys.exit(f"--loader: {which}")
    args.norm = args.norm or ("frozen" if lerobot_trainer else "group")
    info = info_of(args.data)
    where = torch.cuda.get_device_name() if args.device == "cuda" else f"{args.threads} threads"
    print(
        f"ACT {args.preset}, {args.norm} norm, {len(info['cameras'])} cameras, batch {args.batch}, "
        f"{args.device} ({where}), torch {torch.__version__}, {args.rounds} rounds of {args.steps} steps"
    )
    print(which, flush=True)
    precisions = ["float32", "bfloat16"] if args.precision == "both" else [args.precision]
    if args.device == "cpu" and args.precision == "both":
        precisions = ["float32"]
    for precision in precisions:
        print(f"{precision}:", flush=True)
        with tempfile.TemporaryDirectory() as folder:
            told(*compare(args, precision == "bfloat16", info, lerobot_trainer, folder))
        if lerobot_trainer:
            lerobot_trainer.forget()
        gc.collect()
        torch.cuda.empty_cache()


if __name__ == "__main__":
    main()
