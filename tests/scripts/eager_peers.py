"""Our inference beside eager PyTorch: the same weights, the same observation, taking turns in one run.

    cargo build --locked --workspace --bench peers
    strip -o target/peers target/debug/deps/peers-HASH
    python tests/scripts/eager_peers.py target/peers [--device cuda] [--dp3-source FOLDER] [--half-weights]

A debug build does: the network library and trocar-nets, which is optimised in it, do the work. The stripped file can be
carried to a machine with an accelerator.

Peers, each named in the table:
- ACT: LeRobot's own ACTPolicy where lerobot is installed, else a module of this file with the same operations.
- DP3 and SimpleDP3: the authors' encoder and U-Net with the DDIM scheduler of diffusers, where `--dp3-source` names a
  checkout of YanjieZe/3D-Diffusion-Policy (at 47385d9), else a module of this file with the same operations. SimpleDP3's
  U-Net is in another file of theirs and always the module of this file.

Timed, on both sides: from a normalised observation on the device to the answer on the host. Each answer of ours is compared
with the peer's. `--half-weights` gives both sides weights that half precision holds, as those of committed policies are; both
compute in single precision all the same. Memory is what a side's process has more after its answers than before its network.
Needs torch 2.11; the binary loads that torch's libraries on `--device cuda`, and its own otherwise.
"""

import argparse
import json
import math
import os
import pathlib
import statistics
import subprocess
import sys
import tempfile
import time
import types

import torch
from torch import nn
from torch.nn import functional as F

SIDE, WIDTH, HORIZON, CHUNK = 512, 7, 16, 100
CAMERA = "observation.images.endoscope"


def read(path):
    """The tensors of a safetensors file of 32-bit floats; the library is not everywhere."""
    blob = pathlib.Path(path).read_bytes()
    size = int.from_bytes(blob[:8], "little")
    header = json.loads(blob[8 : 8 + size])
    tensors = {}
    for key, entry in header.items():
        if key == "__metadata__":
            continue
        assert entry["dtype"] == "F32", entry
        first, last = entry["data_offsets"]
        data = bytearray(blob[8 + size + first : 8 + size + last])
        tensors[key] = torch.frombuffer(data, dtype=torch.float32).view(entry["shape"])
    weights = {key: value for key, value in tensors.items() if not key.startswith("input.")}
    inputs = {key[6:]: value for key, value in tensors.items() if key.startswith("input.")}
    return weights, inputs


# ---- ACT ----


def lerobot_act(weights, device):
    """LeRobot's ACTPolicy with our weights."""
    os.environ["HF_HUB_OFFLINE"] = "1"
    import lerobot
    from lerobot.configs.types import FeatureType, PolicyFeature
    from lerobot.policies.act.configuration_act import ACTConfig
    from lerobot.policies.act.modeling_act import ACTPolicy

    config = ACTConfig(
        input_features={
            "observation.state": PolicyFeature(FeatureType.STATE, (WIDTH,)),
            CAMERA: PolicyFeature(FeatureType.VISUAL, (3, SIDE, SIDE)),
        },
        output_features={"action": PolicyFeature(FeatureType.ACTION, (WIDTH,))},
        pretrained_backbone_weights=None,
        device=str(device),
        push_to_hub=False,
    )
    policy = ACTPolicy(config)
    policy.load_state_dict(weights, strict=True)
    policy.to(device).eval()

    def answer(inputs):
        return policy.predict_action_chunk(
            {"observation.state": inputs["state"], CAMERA: inputs["images"][:, 0]}
        )

    return f"LeRobot {lerobot.__version__} ACTPolicy", answer


def own_act(weights, device):
    """The operations of LeRobot's ACT in eval mode, in its order, layer by layer."""
    w = {key.removeprefix("model."): value.to(device) for key, value in weights.items()}

    def linear(key, x):
        return F.linear(x, w[f"{key}.weight"], w[f"{key}.bias"])

    def norm(key, x):
        return F.layer_norm(x, [512], w[f"{key}.weight"], w[f"{key}.bias"], 1e-5)

    def frozen(key, x):
        view = lambda name: w[f"{key}.{name}"].reshape(1, -1, 1, 1)
        scale = view("weight") * (view("running_var") + 1e-5).rsqrt()
        return x * scale + (view("bias") - view("running_mean") * scale)

    def conv(key, bn, x, stride, padding):
        return frozen(bn, F.conv2d(x, w[f"{key}.weight"], None, stride, padding))

    def backbone(x):
        x = F.relu(conv("backbone.conv1", "backbone.bn1", x, 2, 3), inplace=True)
        x = F.max_pool2d(x, 3, 2, 1)
        for stage in range(1, 5):
            for block in range(2):
                key = f"backbone.layer{stage}.{block}"
                stride = 2 if stage > 1 and block == 0 else 1
                out = F.relu(conv(f"{key}.conv1", f"{key}.bn1", x, stride, 1), inplace=True)
                out = conv(f"{key}.conv2", f"{key}.bn2", out, 1, 1)
                if stride == 2:
                    x = conv(f"{key}.downsample.0", f"{key}.downsample.1", x, 2, 0)
                x = F.relu(out + x, inplace=True)
        return x

    def attention(key, q, k, v):
        # As nn.MultiheadAttention with its default of returning the weights, which LeRobot leaves.
        return F.multi_head_attention_forward(
            q, k, v, 512, 8, w[f"{key}.in_proj_weight"], w[f"{key}.in_proj_bias"], None, None, False, 0.0,
            w[f"{key}.out_proj.weight"], w[f"{key}.out_proj.bias"], training=False, need_weights=True,
        )[0]  # fmt: skip

    def feed_forward(key, x):
        return linear(f"{key}.linear2", F.relu(linear(f"{key}.linear1", x)))

    def plane(feature):
        ones = torch.ones_like(feature[:1, :1, :, :])[0, 0][None]
        rows, columns = ones.cumsum(1, dtype=torch.float32), ones.cumsum(2, dtype=torch.float32)
        rows = rows / (rows[:, -1:, :] + 1e-6) * 2 * math.pi
        columns = columns / (columns[:, :, -1:] + 1e-6) * 2 * math.pi
        index = torch.arange(256, dtype=torch.float32, device=feature.device)
        divisor = 10000 ** (2 * (index // 2) / 256)
        halves = []
        for angle in (rows, columns):
            angle = angle.unsqueeze(-1) / divisor
            halves.append(torch.stack((angle[..., 0::2].sin(), angle[..., 1::2].cos()), dim=-1).flatten(3))
        return torch.cat(halves, dim=3).permute(0, 3, 1, 2)

    def answer(inputs):
        state, image = inputs["state"], inputs["images"][:, 0]
        feature = backbone(image)
        place = plane(feature)
        feature = F.conv2d(
            feature, w["encoder_img_feat_input_proj.weight"], w["encoder_img_feat_input_proj.bias"]
        )
        latent = linear("encoder_latent_input_proj", torch.zeros(1, 32, device=state.device))
        tokens = [latent, linear("encoder_robot_state_input_proj", state)]
        tokens += list(feature.flatten(2).permute(2, 0, 1))
        places = list(w["encoder_1d_feature_pos_embed.weight"].unsqueeze(1))
        places += list(place.flatten(2).permute(2, 0, 1))
        x, place = torch.stack(tokens, dim=0), torch.stack(places, dim=0)
        for layer in range(4):
            key = f"encoder.layers.{layer}"
            q = x + place
            x = norm(f"{key}.norm1", x + attention(f"{key}.self_attn", q, q, x))
            x = norm(f"{key}.norm2", x + feed_forward(key, x))
        query, key = w["decoder_pos_embed.weight"].unsqueeze(1), "decoder.layers.0"
        y = torch.zeros(CHUNK, 1, 512, device=state.device)
        q = y + query
        y = norm(f"{key}.norm1", y + attention(f"{key}.self_attn", q, q, y))
        y = norm(f"{key}.norm2", y + attention(f"{key}.multihead_attn", y + query, x + place, x))
        y = norm(f"{key}.norm3", y + feed_forward(key, y))
        return linear("action_head", norm("decoder.norm", y).transpose(0, 1))

    return "eager PyTorch with LeRobot's operations", answer


# ---- DP3 ----


class Block(nn.Sequential):
    def __init__(self, inputs, outputs, kernel):
        super().__init__()
        self.block = nn.Sequential(
            nn.Conv1d(inputs, outputs, kernel, padding=kernel // 2), nn.GroupNorm(8, outputs), nn.Mish()
        )

    def forward(self, x):
        return self.block(x)


class Residual(nn.Module):
    def __init__(self, inputs, outputs, condition):
        super().__init__()
        self.outputs = outputs
        self.blocks = nn.ModuleList([Block(inputs, outputs, 5), Block(outputs, outputs, 5)])
        self.cond_encoder = nn.Sequential(nn.Mish(), nn.Linear(condition, 2 * outputs))
        self.residual_conv = nn.Conv1d(inputs, outputs, 1) if inputs != outputs else nn.Identity()

    def forward(self, x, condition):
        embed = self.cond_encoder(condition).reshape(-1, 2, self.outputs, 1)
        out = embed[:, 0] * self.blocks[0](x) + embed[:, 1]
        return self.blocks[1](out) + self.residual_conv(x)


class Resample(nn.Module):
    def __init__(self, conv):
        super().__init__()
        self.conv = conv

    def forward(self, x):
        return self.conv(x)


class Sinusoid(nn.Module):
    def forward(self, x):
        frequencies = torch.exp(torch.arange(64, device=x.device) * -(math.log(10000) / 63))
        angles = x[:, None] * frequencies[None, :]
        return torch.cat((angles.sin(), angles.cos()), dim=-1)


class OwnUnet(nn.Module):
    """The U-Net with the authors' parameter names; `count` residual blocks at every length."""

    def __init__(self, widths, count, condition):
        super().__init__()
        self.diffusion_step_encoder = nn.Sequential(
            Sinusoid(), nn.Linear(128, 512), nn.Mish(), nn.Linear(512, 128)
        )
        condition += 128
        pairs = list(zip([WIDTH, *widths[:-1]], widths))

        def blocks(inputs, outputs):
            first = [Residual(inputs, outputs, condition)]
            return first + [Residual(outputs, outputs, condition) for _ in range(count - 1)]

        self.down_modules = nn.ModuleList()
        for index, (inputs, outputs) in enumerate(pairs):
            last = index == len(pairs) - 1
            shrink = nn.Identity() if last else Resample(nn.Conv1d(outputs, outputs, 3, 2, 1))
            self.down_modules.append(nn.ModuleList([*blocks(inputs, outputs), shrink]))
        self.mid_modules = nn.ModuleList(blocks(widths[-1], widths[-1]))
        self.up_modules = nn.ModuleList()
        for inputs, outputs in reversed(pairs[1:]):
            grow = Resample(nn.ConvTranspose1d(inputs, inputs, 4, 2, 1))
            self.up_modules.append(nn.ModuleList([*blocks(2 * outputs, inputs), grow]))
        self.final_conv = nn.Sequential(Block(widths[0], widths[0], 5), nn.Conv1d(widths[0], WIDTH, 1))

    def forward(self, sample, timestep, global_cond):
        x = sample.permute(0, 2, 1)
        embedded = self.diffusion_step_encoder(timestep.expand(sample.shape[0]))
        condition, beside = torch.cat([embedded, global_cond], dim=-1), []
        for *blocks, shrink in self.down_modules:
            for block in blocks:
                x = block(x, condition)
            beside.append(x)
            x = shrink(x)
        for block in self.mid_modules:
            x = block(x, condition)
        for *blocks, grow in self.up_modules:
            x = torch.cat((x, beside.pop()), dim=1)
            for block in blocks:
                x = block(x, condition)
            x = grow(x)
        return self.final_conv(x).permute(0, 2, 1)


class OwnEncoder(nn.Module):
    """The encoder with the authors' parameter names."""

    def __init__(self):
        super().__init__()
        layers = []
        for inputs, outputs in ((3, 64), (64, 128), (128, 256)):
            layers += [nn.Linear(inputs, outputs), nn.LayerNorm(outputs), nn.ReLU()]
        self.extractor = nn.Module()
        self.extractor.mlp = nn.Sequential(*layers)
        self.extractor.final_projection = nn.Sequential(nn.Linear(256, 64), nn.LayerNorm(64))
        self.state_mlp = nn.Sequential(nn.Linear(WIDTH, 64), nn.ReLU(), nn.Linear(64, 64))

    def forward(self, observation):
        points = torch.max(self.extractor.mlp(observation["point_cloud"]), 1)[0]
        parts = [self.extractor.final_projection(points), self.state_mlp(observation["agent_pos"])]
        return torch.cat(parts, dim=-1)


class OwnScheduler:
    """DDIM predicting the sample, the squared cosine schedule, as the authors set diffusers'."""

    def __init__(self):
        bar = lambda t: math.cos((t + 0.008) / 1.008 * math.pi / 2) ** 2
        betas = [min(1 - bar((i + 1) / 100) / bar(i / 100), 0.999) for i in range(100)]
        self.alphas_cumprod = torch.cumprod(1.0 - torch.tensor(betas, dtype=torch.float32), dim=0)

    def set_timesteps(self, count):
        self.apart = 100 // count
        self.timesteps = (torch.arange(count - 1, -1, -1) * self.apart).to(torch.int64)

    def step(self, clean, t, sample):
        before = t - self.apart
        kept = self.alphas_cumprod[t]
        after = self.alphas_cumprod[before] if before >= 0 else torch.tensor(1.0)
        noise = (sample - kept**0.5 * clean) / (1 - kept) ** 0.5
        clean = clean.clamp(-1, 1)
        return types.SimpleNamespace(prev_sample=after**0.5 * clean + (1 - after) ** 0.5 * noise)


def authors_modules(source):
    """The authors' encoder and U-Net from a checkout, and diffusers' scheduler."""
    sys.path.insert(0, str(next(pathlib.Path(source).rglob("diffusion_policy_3d")).parent))
    from diffusers.schedulers.scheduling_ddim import DDIMScheduler
    from diffusion_policy_3d.model.diffusion.conditional_unet1d import ConditionalUnet1D
    from diffusion_policy_3d.model.vision.pointnet_extractor import DP3Encoder

    class Settings(dict):
        """The authors set a field of what they then pass as keywords."""

        def __setattr__(self, name, value):
            self[name] = value

    cloud = Settings(out_channels=64, use_layernorm=True, final_norm="layernorm", normal_channel=False)
    encoder = DP3Encoder(
        {"point_cloud": (1024, 3), "agent_pos": (WIDTH,)},
        out_channel=64,
        pointcloud_encoder_cfg=cloud,
    )
    unet = ConditionalUnet1D(
        WIDTH, global_cond_dim=256, diffusion_step_embed_dim=128, down_dims=[512, 1024, 2048], kernel_size=5
    )
    scheduler = DDIMScheduler(
        num_train_timesteps=100, beta_start=0.0001, beta_end=0.02, beta_schedule="squaredcos_cap_v2",
        clip_sample=True, set_alpha_to_one=True, steps_offset=0, prediction_type="sample",
    )  # fmt: skip
    return encoder, unet, scheduler


def dp3(weights, device, simple, source):
    """DP3's sampling as the authors' policy has it, around their modules or ours."""
    if source and not simple:
        name = "authors' modules, diffusers' DDIM"
        encoder, unet, scheduler = authors_modules(source)
    else:
        name = "eager PyTorch with the authors' operations"
        widths, count = ((128, 256, 384), 1) if simple else ((512, 1024, 2048), 2)
        encoder, unet, scheduler = OwnEncoder(), OwnUnet(widths, count, 256), OwnScheduler()
    part = lambda prefix: {k.removeprefix(prefix): v for k, v in weights.items() if k.startswith(prefix)}
    encoder.load_state_dict(part("obs_encoder."), strict=True)
    unet.load_state_dict(part("model."), strict=True)
    encoder.to(device).eval()
    unet.to(device).eval()

    def answer(inputs):
        observation = {"point_cloud": inputs["points"].flatten(0, 1), "agent_pos": inputs["state"].flatten(0, 1)}
        condition = encoder(observation).reshape(1, -1)
        trajectory = inputs["noise"]
        scheduler.set_timesteps(10)
        for t in scheduler.timesteps:
            timestep = t[None].to(trajectory.device)
            clean = unet(trajectory, timestep, global_cond=condition)
            trajectory = scheduler.step(clean, t, trajectory).prev_sample
        return trajectory

    return name, answer


# ---- the run ----


class Ours:
    """The binary of `tests/benches/peers.rs`."""

    def __init__(self, binary, folder, device, threads):
        environment = dict(os.environ)
        if device == "cuda":
            # Built against a libtorch without CUDA, it runs on this one; the linker left out what is not named here.
            libraries = pathlib.Path(torch.__file__).parent / "lib"
            others = sorted(libraries.parent.parent.glob("nvidia/*/lib"))
            environment["LD_LIBRARY_PATH"] = ":".join(map(str, [libraries, *others]))
            environment["LD_PRELOAD"] = str(libraries / "libtorch_cuda.so")
        self.folder = pathlib.Path(folder)
        self.process = subprocess.Popen(
            [binary, folder, device, str(threads)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, env=environment
        )

    def ask(self, request):
        self.process.stdin.write(f"{request}\n".encode())
        self.process.stdin.flush()
        line = self.process.stdout.readline()
        if not line:
            sys.exit(f"{request}: the binary ended with {self.process.wait()}")
        return json.loads(line)

    def time(self, name, runs):
        reply = self.ask(f"time {name} {runs}")
        answer, _ = read(self.folder / f"{name}.answer.safetensors")
        return list(zip(reply["wall_ns"], reply["processor_ns"])), answer["answer"]


def time_peer(answer, inputs, runs):
    times, given = [], answer(inputs).cpu()
    for _ in range(runs):
        wall, processor = time.monotonic_ns(), time.thread_time_ns()
        given = answer(inputs).cpu()
        times.append((time.monotonic_ns() - wall, time.thread_time_ns() - processor))
    return times, given


def figures(times):
    """Median and 99th percentile of the wall time, least and median processor time of the calling thread; ms."""
    wall, processor = (sorted(t[i] / 1e6 for t in times) for i in (0, 1))
    percentile = wall[min(len(wall) - 1, math.ceil(0.99 * len(wall)) - 1)]
    return statistics.median(wall), percentile, processor[0], statistics.median(processor)


def row(what, times, base=None):
    wall, last, least, processor = figures(times)
    line = f"  {what:52} {wall:9.2f} {last:9.2f} {least:9.2f} {processor:9.2f}"
    if base:
        ours = (wall, last, least, processor)
        # A calling thread may take less than its clock can tell.
        ratio = [theirs / mine if mine > 0 else math.nan for theirs, mine in zip(figures(base), ours)]
        line += "   times faster: " + " ".join(f"{r:.2f}" for r in ratio)
    print(line, flush=True)


def resident(process="self"):
    """Memory of a process, MB."""
    for line in pathlib.Path(f"/proc/{process}/status").read_text().splitlines():
        if line.startswith("VmRSS:"):
            return int(line.split()[1]) / 1000
    return math.nan


def compare(ours, network, options, device, inputs_on):
    rounds, runs = options.rounds, options.runs
    our_memory, their_memory = resident(ours.process.pid), resident()
    made = f"{network}-half" if options.half_weights else network
    ours.ask(f"make {made}")
    weights, inputs = read(ours.folder / f"{made}.safetensors")
    if network == "act":
        try:
            if options.plain:
                raise ImportError("not asked for")
            name, answer = lerobot_act(weights, device)
        except ImportError as error:
            print(f"  no LeRobot ({error})")
            name, answer = own_act(weights, device)
    else:
        name, answer = dp3(weights, device, network == "simple-dp3", None if options.plain else options.dp3_source)
    del weights
    inputs = {key: inputs_on(value) for key, value in inputs.items()}
    ours_times, their_times = [], []
    for _ in range(rounds):
        ours_now, our_answer = ours.time(made, runs)
        theirs_now, their_answer = time_peer(answer, inputs, runs)
        ours_times += ours_now
        their_times += theirs_now
    our_memory, their_memory = resident(ours.process.pid) - our_memory, resident() - their_memory
    scale = their_answer.abs().max().item()
    off = (our_answer - their_answer).abs().max().item() / scale
    what = f"{network}, weights that half precision holds" if options.half_weights else network
    print(f"{what}: {len(ours_times)} answers each, ours off by {off:.1e} of the peer's greatest number {scale:.2f}")
    print(f"  memory: the peer {their_memory:.0f} MB, ours {our_memory:.0f} MB")
    row(name, their_times)
    row("ours", ours_times, their_times)
    if options.device == "cuda" or options.bf16:
        half = f"{made}-bf16"
        ours.ask(f"make {half}")
        times = []
        for _ in range(rounds):
            now, half_answer = ours.time(half, runs)
            times += now
        half_off = (half_answer - their_answer).abs().max().item() / scale
        row(f"ours, bf16, off by {half_off:.1e}", times, their_times)
        ours.ask(f"drop {half}")
    ours.ask(f"drop {made}")
    # TF32 convolutions, which are PyTorch's default on CUDA, leave 11 bits on either side.
    if not off < (1e-2 if options.device == "cuda" else 1e-4):
        sys.exit(f"{network}: the answers have nothing to do with each other")


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("binary", help="built from tests/benches/peers.rs")
    parser.add_argument("--device", choices=["cpu", "cuda"], default="cpu")
    parser.add_argument("--threads", type=int, default=1, help="of the network library, on both sides")
    parser.add_argument("--networks", nargs="+", default=["act", "dp3", "simple-dp3"])
    parser.add_argument("--rounds", type=int, default=5, help="turns that each side has")
    parser.add_argument("--runs", type=int, default=6, help="answers in a turn")
    parser.add_argument("--bf16", action="store_true", help="ours in bf16 too, on the CPU; always on cuda")
    parser.add_argument("--half-weights", action="store_true", help="weights that half precision holds, on both sides")
    parser.add_argument("--plain", action="store_true", help="this file's modules, whatever is installed")
    parser.add_argument("--dp3-source", help="checkout of YanjieZe/3D-Diffusion-Policy")
    options = parser.parse_args()
    torch.set_num_threads(options.threads)
    device = torch.device(options.device)
    where = torch.cuda.get_device_name() if options.device == "cuda" else f"{options.threads} threads"
    load = os.getloadavg()[0]
    print(f"torch {torch.__version__}, {options.device}, {where}, load {load:.1f}")
    print(f"  {'ms:':52} {'median':>9} {'p99':>9} {'cpu min':>9} {'cpu med':>9}")
    with tempfile.TemporaryDirectory() as folder, torch.inference_mode():
        ours = Ours(options.binary, folder, options.device, options.threads)
        for network in options.networks:
            compare(ours, network, options, device, lambda tensor: tensor.to(device))


if __name__ == "__main__":
    main()
