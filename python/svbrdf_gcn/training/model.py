"""The `default` network: any number of photos with their light and half vectors in, raw maps and their certainty out.

Per photo, shared weights, full resolution: a 3x3 convolution of the 13 planes of `TrainingData.batch` and NAFNet blocks (`stem`
channels); a 2x2 convolution of stride 2 leads to half resolution (`node` channels).
Graph: the photos are the nodes of a complete graph with loops. In every round, per pixel at half resolution, the edge weights are a softmax
over the senders j of `query_i . key_j / sqrt(dim) + pair . (h_i . h_j, l_i . l_j) + [i = j] loop` (per head; l, h: directions of light
and half vector), and every node gains what its edges bring and passes through a block. Nothing depends on the order of photos.
Hints: what classical analysis tells without learning, `hints`: where the surface leans and how dark and bright it gets.
Pooling: mean, maximum and standard deviation over the photos of nodes and stem features, the hints, and 1/N.
Trunk: a small NAFNet U-Net on the pooled nodes at half resolution, most blocks above the bottleneck. Tail: 1x1 convolution and pixel
shuffle to full resolution, plus the pooled stem features, blocks, a 3x3 convolution `ending` to the material feature H. Each map
comes from H by an adapter of the paper's form. Certainty: one more block and convolution beside `ending` give the logarithm of a standard
deviation for each of the nine raw values, in units of the encoded map (raw albedos and roughness over 2; normal x and y as they are).

Channel attention averages over a window around each pixel, cut off at the picture's edge by moving the window inwards. With a
window of at least the picture it is the global average; training sees pictures of the window's size, larger ones go the local way.
"""

import torch
import torch.nn as nn
import torch.nn.functional as functional

# Planes of the network's input per photo, see `TrainingData.batch`.
INPUTS = 13
# Largest encoded ratio to a white diffuse surface that the network is shown.
RATIO_MAX = 4.0
ADAPTERS = (("diff_conv", 3), ("normal_conv", 2), ("rough_conv", 1), ("spec_conv", 3))
NORM_EPS = 1e-6
# Added to the variance over photos before its root.
SPREAD_EPS = 1e-4
# Planes of `hints`.
HINTS = 10
# Ridge of the regression in `hints`, in squared units of the half vectors.
HINT_RIDGE = 1e-2
# What the contributions of blocks and messages are scaled by at the start; zero, as published, learns nothing for too long.
SCALE_START = 0.3
# Bounds of the logarithm of the standard deviation.
LOG_SIGMA = (-7.0, 1.0)

DEFAULT = {"stem": 16, "stem_blocks": 0, "node": 32, "heads": 2, "dim": 8, "rounds": 1, "width": 64, "blocks": [2, 3], "middle": 3, "tail": 16, "tail_blocks": 1, "feature": 9, "window": 96, "roughness_floor": -0.5}  # fmt: skip


def window_mean(x, window):
    """Means of `x` (B, C, H, W) over windows of `window` x `window` pixels around each pixel, moved inwards at the edges.

    The window of pixel i begins at i - window // 2, limited to the picture. Returns (B, C, 1, 1) if one window covers the picture.
    """
    height, width = x.shape[-2:]
    if window is None or window >= max(height, width):
        return x.mean((-2, -1), keepdim=True)
    for dim, length in ((-1, width), (-2, height)):
        span = min(window, length)
        sums = functional.pad(x.transpose(dim, -1).double().cumsum(-1), (1, 0))
        start = (torch.arange(length, device=x.device) - span // 2).clamp(0, length - span)
        x = ((sums[..., start + span] - sums[..., start]) / span).to(x.dtype).transpose(dim, -1)
    return x


class Norm(nn.Module):
    """Layer norm over channels, per pixel."""

    def __init__(self, channels):
        super().__init__()
        self.weight = nn.Parameter(torch.ones(channels))
        self.bias = nn.Parameter(torch.zeros(channels))

    def forward(self, x):
        with torch.autocast(x.device.type, enabled=False):
            y = functional.layer_norm(x.permute(0, 2, 3, 1), self.weight.shape, self.weight.to(x.dtype), self.bias.to(x.dtype), NORM_EPS)
        return y.permute(0, 3, 1, 2)


def gate(x):
    a, b = x.chunk(2, 1)
    return a * b


def scaled(x, factor):
    """`x` times a parameter per channel, in the precision of `x`."""
    return x * factor.to(x.dtype)[:, None, None]


class Block(nn.Module):
    """NAFNet block (Chen et al. 2022); names as in the paper's released weights."""

    def __init__(self, channels):
        super().__init__()
        self.norm1, self.norm2 = Norm(channels), Norm(channels)
        self.conv1 = nn.Conv2d(channels, 2 * channels, 1)
        self.conv2 = nn.Conv2d(2 * channels, 2 * channels, 3, padding=1, groups=2 * channels)
        self.sca = nn.Sequential(nn.Identity(), nn.Conv2d(channels, channels, 1))
        self.conv3 = nn.Conv2d(channels, channels, 1)
        self.conv4 = nn.Conv2d(channels, 2 * channels, 1)
        self.conv5 = nn.Conv2d(channels, channels, 1)
        self.beta = nn.Parameter(torch.full((channels,), SCALE_START))
        self.gamma = nn.Parameter(torch.full((channels,), SCALE_START))

    def forward(self, x, window):
        y = gate(self.conv2(self.conv1(self.norm1(x))))
        y = self.conv3(y * self.sca(window_mean(y, window)))
        x = x + scaled(y, self.beta)
        return x + scaled(self.conv5(gate(self.conv4(self.norm2(x)))), self.gamma)


class Round(nn.Module):
    """One round of messages between photos."""

    def __init__(self, channels, heads, dim):
        super().__init__()
        self.heads, self.dim = heads, dim
        self.norm = Norm(channels)
        self.query = nn.Conv2d(channels, heads * dim, 1)
        self.key = nn.Conv2d(channels, heads * dim, 1)
        self.value = nn.Conv2d(channels, channels, 1)
        self.out = nn.Conv2d(channels, channels, 1)
        self.pair = nn.Parameter(torch.zeros(heads, 2))
        self.loop = nn.Parameter(torch.zeros(heads))
        self.gain = nn.Parameter(torch.full((channels,), SCALE_START))
        self.block = Block(channels)

    def forward(self, nodes, likeness, batch, window):
        """`nodes` (B N, C, H, W); `likeness` (B, 2, N, N, H, W): h_i . h_j and l_i . l_j."""
        x = self.norm(nodes)
        count, (height, width) = len(nodes) // batch, nodes.shape[-2:]

        def split(y):
            return y.reshape(batch, count, self.heads, -1, height, width)

        query, key, value = split(self.query(x)), split(self.key(x)), split(self.value(x))
        # (B, N, N, heads, H, W), receivers before senders.
        logits = (query[:, :, None] * key[:, None]).sum(4, dtype=torch.promote_types(query.dtype, torch.float32)) / self.dim**0.5
        bias = sum(likeness[:, k, :, :, None] * self.pair[:, k, None, None] for k in range(2))
        loop = torch.eye(count, device=x.device)[:, :, None, None, None] * self.loop[:, None, None]
        weights = torch.softmax(logits + bias + loop, 2).to(value.dtype)
        brought = torch.stack([(weights[:, i, :, :, None] * value).sum(1) for i in range(count)], 1)
        nodes = nodes + scaled(self.out(brought.reshape(nodes.shape)), self.gain)
        return self.block(nodes, window)


def pooled(x, batch):
    """Mean, maximum and standard deviation over photos of (B N, C, H, W)."""
    x = x.reshape(batch, -1, *x.shape[1:])
    mean = x.mean(1)
    spread = ((x - mean[:, None]) ** 2).mean(1)
    return torch.cat([mean, x.amax(1), (spread + SPREAD_EPS).sqrt()], 1)


def hints(inputs):
    """Planes (B, 10, H, W) from inputs (B, N, 13, H, W), the same for any order of photos.

    With c the mean over colours of the encoded ratio to white, and h the x and y of the half vector: the slope of c in h over the photos
    (ridge regression) over the mean of c, 2 (towards which side the surface leans); the mean of h with weights c^4 less its mean
    without, 2 (where highlights lie); the smallest ratio, 3, and the mean ratio, 3.
    """
    ratio, half = inputs[:, :, 3:6], inputs[:, :, 10:12]
    code = ratio.mean(2, keepdim=True)
    mean_code, mean_half = code.mean(1), half.mean(1)
    off = half - mean_half[:, None]
    xx, yy = (off * off).mean(1).split(1, 1)
    xy = (off[:, :, :1] * off[:, :, 1:]).mean(1)
    cx, cy = ((code - mean_code[:, None]) * off).mean(1).split(1, 1)
    xx, yy = xx + HINT_RIDGE, yy + HINT_RIDGE
    scale = 1 / ((xx * yy - xy * xy) * mean_code.clamp_min(0.02))
    slope = torch.cat([(yy * cx - xy * cy) * scale, (xx * cy - xy * cx) * scale], 1)
    weight = code**4
    bright = (weight * off).sum(1) / weight.sum(1).clamp_min(1e-6)
    return torch.cat([slope.clamp(-4, 4), bright, ratio.amin(1), ratio.mean(1)], 1)


class Adapter(nn.Module):
    def __init__(self, channels, outputs):
        super().__init__()
        self.conv = Block(channels)
        self.end = nn.Conv2d(channels, outputs, 3, padding=1)

    def forward(self, x, window):
        return self.end(self.conv(x, window))


class Model(nn.Module):
    """See the module's documentation. `config` is a dictionary with the keys of `DEFAULT`."""

    def __init__(self, config):
        super().__init__()
        unknown = set(config) ^ set(DEFAULT)
        if unknown:
            raise ValueError(f"model: these settings are unknown or missing: {', '.join(sorted(unknown))}")
        self.config = dict(config)
        self.memory_format = torch.contiguous_format
        stem, node, width, tail = (config[key] for key in ("stem", "node", "width", "tail"))
        levels = len(config["blocks"])

        def blocks(count, channels):
            return nn.ModuleList(Block(channels) for _ in range(count))

        self.intro = nn.Conv2d(INPUTS, stem, 3, padding=1)
        self.stem = blocks(config["stem_blocks"], stem)
        self.fold = nn.Conv2d(stem, node, 2, stride=2)
        self.node = blocks(1, node)
        self.rounds = nn.ModuleList(Round(node, config["heads"], config["dim"]) for _ in range(config["rounds"]))
        self.entry = nn.Conv2d(3 * node + 1 + HINTS, width, 1)
        self.encoders = nn.ModuleList(blocks(count, width << level) for level, count in enumerate(config["blocks"]))
        self.downs = nn.ModuleList(nn.Conv2d(width << level, width << level + 1, 2, stride=2) for level in range(levels))
        self.middle_blks = blocks(config["middle"], width << levels)
        coarse_first = range(levels - 1, -1, -1)
        self.ups = nn.ModuleList(nn.ModuleList([nn.Conv2d(width << level + 1, width << level + 2, 1, bias=False)]) for level in coarse_first)
        self.decoders = nn.ModuleList(blocks(config["blocks"][level], width << level) for level in coarse_first)
        self.unfold = nn.Conv2d(width, 4 * tail, 1, bias=False)
        self.skip = nn.Conv2d(3 * stem + 1 + HINTS, tail, 1)
        self.tail = blocks(config["tail_blocks"], tail)
        self.ending = nn.Conv2d(tail, config["feature"], 3, padding=1)
        for name, outputs in ADAPTERS:
            setattr(self, name, Adapter(config["feature"], outputs))
        self.certainty = Adapter(tail, sum(outputs for _, outputs in ADAPTERS))

    def at(self, level, window):
        """The window of channel attention in pixels of a level, 0 the full resolution."""
        return None if window is None else max(window >> level, 1)

    def laid(self, x):
        """`x` in the memory layout that the network runs in."""
        return x.contiguous(memory_format=self.memory_format)

    def fuse(self, inputs, window):
        """Pooled features of the photos at full and at half resolution."""
        batch, count = inputs.shape[:2]
        directions = inputs[:, :, 7:13]
        x = self.intro(self.laid(inputs.flatten(0, 1)))
        for block in self.stem:
            x = block(x, self.at(0, window))
        share = torch.full_like(x[:batch, :1], 1 / count)
        hint = hints(inputs)
        fine = torch.cat([pooled(x, batch), hint, share], 1)
        x = self.fold(x)
        for block in self.node:
            x = block(x, self.at(1, window))
        coarse = functional.avg_pool2d(directions.flatten(0, 1), 2).reshape(batch, count, 2, 3, *x.shape[-2:])
        likeness = torch.stack([(coarse[:, :, None, k] * coarse[:, None, :, k]).sum(3) for k in (1, 0)], 1)
        for messages in self.rounds:
            x = messages(x, likeness, batch, self.at(1, window))
        return fine, torch.cat([pooled(x, batch), functional.avg_pool2d(hint, 2), share[..., ::2, ::2]], 1)

    def restore(self, fine, coarse, window):
        """Raw maps and the logarithm of their standard deviations from pooled features."""
        levels = len(self.encoders)
        x = self.entry(self.laid(coarse))
        skips = []
        for level, (encoder, down) in enumerate(zip(self.encoders, self.downs)):
            for block in encoder:
                x = block(x, self.at(level + 1, window))
            skips.append(x)
            x = down(x)
        for block in self.middle_blks:
            x = block(x, self.at(levels + 1, window))
        for level, up, decoder in zip(range(levels - 1, -1, -1), self.ups, self.decoders):
            x = self.laid(functional.pixel_shuffle(up[0](x), 2)) + skips[level]
            for block in decoder:
                x = block(x, self.at(level + 1, window))
        x = self.laid(functional.pixel_shuffle(self.unfold(x), 2)) + self.skip(self.laid(fine))
        for block in self.tail:
            x = block(x, self.at(0, window))
        # The certainty learns from the features without changing them.
        log_sigma = self.certainty(x.detach(), self.at(0, window))
        # The adapters in full precision: 8 bits of mantissa are too few for maps.
        full = self.ending.weight.dtype
        with torch.autocast(x.device.type, enabled=False):
            feature = self.ending(x.to(full))
            raw = torch.cat([getattr(self, name)(feature, self.at(0, window)) for name, _ in ADAPTERS], 1)
            log_sigma = log_sigma.to(full).clamp(*LOG_SIGMA)
        return raw, log_sigma

    def forward(self, inputs, window="config"):
        """Raw maps (B, 9, H, W) and the logarithm of their standard deviations, of inputs (B, N, 13, H, W).

        `window`: pixels of the averages of channel attention at full resolution; None for global averages. Pictures whose sides are no
        multiple of the coarsest pixel are padded with zeros at the right and bottom.
        """
        window = self.config["window"] if window == "config" else window
        height, width = inputs.shape[-2:]
        grain = 2 ** (len(self.encoders) + 1)
        fine, coarse = self.fuse(functional.pad(inputs, (0, -width % grain, 0, -height % grain)), window)
        raw, log_sigma = self.restore(fine, coarse, window)
        return raw[..., :height, :width], log_sigma[..., :height, :width]


def cost(model, photos=4, size=256):
    """Parameters of a network, and multiply-adds of one run on `photos` photos of `size` x `size`, counted layer by layer."""
    config, total = model.config, 0

    def count(layer, _, out):
        nonlocal total
        per_output = layer.in_channels // layer.groups * layer.kernel_size[0] * layer.kernel_size[1]
        total += out.numel() * per_output

    for layer in model.modules():
        if isinstance(layer, nn.Conv2d):
            layer.register_forward_hook(count)
    small = size // 8
    with torch.no_grad():
        model(torch.zeros(1, photos, INPUTS, small, small))
    # Edges: products of queries with keys, and weighted values.
    edges = 0 if "heads" not in config else photos**2 * (config["heads"] * config["dim"] + config["node"]) * (small // 2) ** 2 * config["rounds"]
    return sum(parameter.numel() for parameter in model.parameters()), (total + edges) * 64
