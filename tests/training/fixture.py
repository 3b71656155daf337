#!/usr/bin/env python3
"""Makes tests/fixtures/default with a tiny network of the default architecture, in double precision: fixture.py tests/fixtures/default

A network with random weights, and what it answers. `weights.safetensors` is as export.py writes it (f32). `expected.safetensors`: three photos of 14 x 18 pixels (no multiple of the
coarsest pixel), `photos`, `saturated`, stated `camera`, `light`, `intensity` in units of half the patch's width (patch_size 2), the
network's `inputs`, their `hints` when continued with zeros to 16 x 24 pixels, and `raw`, `log_sigma`, `maps` with channel attention over
windows of 16 pixels; `raw_global` with global averages; `raw_single` of the first photo alone.
"""

import math
import sys
from pathlib import Path

import torch
import torch.nn.functional as functional

from svbrdf_gcn.training import export, store
from svbrdf_gcn.training.maps import GAMMA, decode_maps
from svbrdf_gcn.training.model import RATIO_MAX, Model, hints
from svbrdf_gcn.training.render import directions, pixel_positions

CONFIG = {"stem": 4, "stem_blocks": 1, "node": 4, "heads": 2, "dim": 2, "rounds": 2, "width": 4, "blocks": [1, 1], "middle": 1, "tail": 5, "tail_blocks": 1, "feature": 9, "window": 16, "roughness_floor": -0.5}  # fmt: skip
SEED = 20_240_102


def network_input(photos, saturated, camera, light, intensity):
    """What the network sees of photos (B, N, 3, H, W) in gamma 2.2, stated in the frame in which they cover x from -1 to 1: (B, N, 13, H, W).

    The photo, 3; the gamma 2.2 encoding of its ratio to what a white diffuse patch facing +z would show under the stated light, 3, at most 4;
    saturation, 1; direction to the light, 3; half vector, 3.
    """
    position = pixel_positions(*photos.shape[-2:], dtype=photos.dtype)[None]
    _, light_dir, half, distance2 = directions(position, camera, light)
    white = intensity[..., None, None] / distance2 * light_dir[..., 2:3, :, :].clamp_min(0) / math.pi
    ratio = (photos.clamp_min(0) ** GAMMA / white.clamp_min(1e-4)).clamp(1e-6, RATIO_MAX**GAMMA) ** (1 / GAMMA)
    return torch.cat([photos, ratio, saturated, light_dir, half], 2)


def random_weights(config, rng):
    """Random tensors of a network."""
    weights = {}
    for name, parameter in Model(config).named_parameters():
        spread = 0.7 * parameter[0].numel() ** -0.5 if parameter.dim() == 4 else 0.3
        centre = 1.0 if name.endswith(("norm1.weight", "norm2.weight", "norm.weight")) else 0.0
        weights[name] = centre + spread * torch.randn(parameter.shape, generator=rng)
    return weights


def made_up():
    """Random tensors of the network, and photos with their geometry, in f32."""
    rng = torch.Generator().manual_seed(SEED)
    weights = random_weights(CONFIG, rng)
    photos = (torch.rand(3, 3, 14, 18, generator=rng) * 1.1).clamp_max(1)
    place = torch.tensor([[0.1, -0.2, 2.5], [1.2, 0.4, 3.0], [-2.0, 1.5, 5.0]])
    return weights, {
        "photos": photos,
        "saturated": (photos.amax(1, keepdim=True) >= 1).float(),
        "camera": place,
        "light": place + torch.tensor([[0.0, 0.0, 0.0], [0.1, 0.0, -0.05], [3.0, -1.0, 0.5]]),
        "intensity": torch.tensor([[20.0, 21.0, 19.0], [30.0, 28.0, 31.0], [90.0, 80.0, 85.0]]),
    }


def answers(weights, given):
    """What the network of these weights makes of the photos, computed in f64."""
    model = Model(CONFIG).double()
    model.load_state_dict({name: tensor.double() for name, tensor in weights.items()})
    given = {name: tensor.double()[None] for name, tensor in given.items()}
    with torch.no_grad():
        inputs = network_input(*(given[name] for name in ("photos", "saturated", "camera", "light", "intensity")))
        raw, log_sigma = model(inputs)
        out = {"inputs": inputs, "raw": raw, "log_sigma": log_sigma, "maps": decode_maps(raw, CONFIG["roughness_floor"])}
        out.update(raw_global=model(inputs, None)[0], raw_single=model(inputs[:, :1])[0])
        out["hints"] = hints(functional.pad(inputs, (0, 6, 0, 2)))
    return {name: tensor[0].float() for name, tensor in out.items()}


def main(folder):
    folder.mkdir(parents=True, exist_ok=True)
    weights, given = made_up()
    export.write(folder / "weights.safetensors", weights, {"network": "photo graph", "model": CONFIG}, {"license": "CC0-1.0", "data": "random weights"}, torch.float32)
    store.save(folder / "expected.safetensors", {**given, **answers(weights, given)})


if __name__ == "__main__":
    main(Path(sys.argv[1]))
