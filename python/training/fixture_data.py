#!/usr/bin/env python3
"""Makes tests/fixtures/training/data.safetensors: what the training data of this trainer are where nothing is random.

    fixture_data.py tests/fixtures/training/data.safetensors

`maps` and `other` are materials of 14 x 14 pixels. `crop I` are crops of 8 x 8 pixels of the first, `crops` (4, 6) how they lie: step,
angle, centre x and y, flip. Every uniform random number is then U, every Gaussian one G, for the (U, G) of `draws`: `views I` (4, 9) are
camera, light and intensity of the views of the loss; `varied I` the first material varied; `mixed I` mixed with the other; `shots I` (2, 9)
the stated geometry of a capture of it, `window I` the share and centre of what is seen, `photos I`, `saturated I`, `normal I` the capture,
and `inputs I` what the network sees.
"""

import sys
from pathlib import Path

import torch

import augment
import camera
import library
import losses
import store
from maps import NORMAL, join, normal_from_slopes

SEED = 20_240_103
SIZE, PHOTOS, VIEWS = 14, 2, 4
# The first photographs a level sample from near with care, the second a tile of a leaning one, the third with the light elsewhere.
DRAWS = ((0.2, 0.5), (0.36, -0.3), (0.8, 0.4))


def made_up():
    """Two materials (2, 10, H, W)."""
    rng = torch.Generator().manual_seed(SEED)

    def uniform(low, high, channels):
        return torch.rand(2, channels, SIZE, SIZE, generator=rng) * (high - low) + low

    x, y = (0.2 * torch.randn(2, 1, SIZE, SIZE, generator=rng) for _ in range(2))
    return join(uniform(0.02, 0.9, 3), normal_from_slopes(x, y), uniform(0.1, 0.9, 1), uniform(0.02, 0.5, 3))


def crops(maps):
    """Crops of the first material, and how they lie."""
    place = torch.tensor([
        [1.0, 0.0, 0.5, 0.5, 1.0],
        [0.7, 0.6, 0.1, 0.95, 1.0],
        [1.3, -2.0, 0.3, 0.2, -1.0],
        [1.9, 4.0, 0.7, 0.05, -1.0],
    ])  # fmt: skip
    bank = library.to_planes(maps[:1])
    levels, index = [bank, library.halved(bank)], torch.zeros(len(place), dtype=torch.long)
    out = library.sample_crops(levels, index, 8, place[:, 0], place[:, 1], place[:, 2:4], place[:, 4])
    return {"crops": place, **{f"crop {number}": crop for number, crop in enumerate(out)}}


def drawn(maps, uniform, gaussian):
    """All that is drawn where uniform random numbers are `uniform` and Gaussian ones `gaussian`."""

    def constant(value):
        return lambda *shape, generator=None, device=None: torch.full(shape[0] if isinstance(shape[0], torch.Size) else shape, value)

    kept = torch.rand, torch.randn
    torch.rand, torch.randn = constant(uniform), constant(gaussian)
    try:
        first, other = maps[:1], maps[1:]
        dice = augment.Dice(None, 1, "cpu")
        varied = augment.rebump(augment.reroughen(augment.respecular(augment.recolour(first, dice), dice), dice), dice)
        out = {"varied": varied, "mixed": augment.mixed(first, other, dice)}
        out["views"] = torch.cat(losses.draw_views(None, 1, VIEWS), -1)
        geometry = camera.draw_geometry(None, 1, PHOTOS, SIZE, SIZE, "cpu")
        capture = camera.photograph(first, geometry, None, None)
    finally:
        torch.rand, torch.randn = kept
    stated = capture.stated
    x, y = stated.position[0, 0, 0], stated.position[0, 1, :, 0]
    share = (x[-1] - x[0]) / 2 * SIZE / (SIZE - 1)
    out["window"] = torch.stack([share, (x[0] + x[-1]) / 2, (y[0] + y[-1]) / 2])[None]
    out["shots"] = torch.cat([stated.camera, stated.light, stated.intensity], -1)
    out["inputs"] = camera.network_input(capture.photos, capture.saturated, stated)
    out.update(photos=capture.photos, saturated=capture.saturated, normal=capture.maps[:, NORMAL])
    return {name: tensor[0] for name, tensor in out.items()}


def main(path):
    path.parent.mkdir(parents=True, exist_ok=True)
    maps = made_up()
    tensors = {"maps": maps[0], "other": maps[1], "draws": torch.tensor(DRAWS), **crops(maps)}
    for number, (uniform, gaussian) in enumerate(DRAWS):
        tensors.update({f"{name} {number}": tensor for name, tensor in drawn(maps, uniform, gaussian).items()})
    store.save(path, {name: tensor.float() for name, tensor in tensors.items()})


if __name__ == "__main__":
    main(Path(sys.argv[1]))
