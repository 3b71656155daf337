"""Banks of materials that crops are sampled from: the packed library and the pool of procedural materials.

A bank holds planes (M, 9, S, S): diffuse and specular albedo as gamma 2.2 codes, normal x and y, roughness, in the order of
`PLANES`, all periodic: a crop may run over the edge.
"""

import io
import json
import math
import zipfile

import numpy as np
import torch
import torch.nn.functional as functional
from PIL import Image

import procedural
from maps import GAMMA, join

# Planes of a bank: diffuse 3, normal 2, roughness 1, specular 3.
PLANES = 9


def to_planes(maps):
    """Bank planes in half precision of maps (..., 10, H, W)."""
    diffuse, normal, roughness, specular = maps.split([3, 3, 1, 3], -3)
    codes = [diffuse.clamp(0, 1) ** (1 / GAMMA), normal[..., :2, :, :], roughness, specular.clamp(0, 1) ** (1 / GAMMA)]
    return torch.cat(codes, -3).half()


def from_planes(planes):
    """Maps of bank planes, which may have been interpolated."""
    diffuse, xy, roughness, specular = planes.float().split([3, 2, 1, 3], -3)
    z = (1 - (xy * xy).sum(-3, keepdim=True)).clamp_min(0.01).sqrt()
    normal = torch.cat([xy, z], -3)
    normal = normal / (normal * normal).sum(-3, keepdim=True).sqrt()
    return join(diffuse.clamp(0, 1) ** GAMMA, normal, roughness.clamp(0, 1), specular.clamp(0, 1) ** GAMMA)


def decode_srgb(code):
    return torch.where(code <= 0.04045, code / 12.92, ((code.clamp_min(0.04045) + 0.055) / 1.055) ** 2.4)


def open_pack(path, validation):
    """Names and bank of the materials of a pack that are held out for validation, or of all others."""
    names, banks = [], []
    with zipfile.ZipFile(path) as archive:
        index = json.loads(archive.read("materials.json"))

        def plane(name, kind):
            with Image.open(io.BytesIO(archive.read(f"{name}/{kind}.jpg"))) as image:
                pixels = np.array(image, np.float32) / 255
            return torch.from_numpy(pixels if pixels.ndim == 3 else pixels[..., None]).permute(2, 0, 1)

        for entry in index["materials"]:
            if bool(entry.get("validation")) != validation:
                continue
            name = entry["name"]
            base = decode_srgb(plane(name, "basecolor"))
            normal = plane(name, "normal") * 2 - 1
            normal = normal / (normal * normal).sum(0, keepdim=True).sqrt().clamp_min(1e-6)
            metallic = plane(name, "metallic") if entry["metallic"] else torch.zeros_like(base[:1])
            maps = join(base * (1 - metallic), normal, plane(name, "roughness"), 0.04 * (1 - metallic) + base * metallic)
            names.append(name)
            banks.append(to_planes(maps))
    if not banks:
        raise SystemExit(f"{path}: no materials {'to validate on' if validation else 'to train on'}")
    return names, torch.stack(banks)


def halved(bank):
    """The bank at half the resolution; normals are averaged as slopes are, roughly."""
    return torch.cat([functional.avg_pool2d(part.float(), 2).half() for part in bank.split(32)])


def sample_crops(levels, index, size, step, angle, centre, flip):
    """Maps (B, 10, size, size) of crops, and turned normals.

    `levels` is a bank and its halves; `index` (B,) the material, `step` (B,) how many pixels of the bank one pixel of the crop spans,
    `angle` (B,) by which the crop is turned counter-clockwise, `centre` (B, 2) in [0, 1], `flip` (B,) 1 or -1: mirrored in x. All
    live on the CPU.
    """
    device = levels[0].device
    out = torch.empty(len(index), 10, size, size, device=device)
    level = (step > 1.4).long().clamp_max(len(levels) - 1)
    ticks = torch.arange(size, device=device) - (size - 1) / 2
    for number, bank in enumerate(levels):
        rows = torch.nonzero(level == number)[:, 0]
        if len(rows) == 0:
            continue
        where = rows.to(device)
        side = bank.shape[-1]
        cosine, sine = (function(angle[rows]).to(device)[:, None, None] for function in (torch.cos, torch.sin))
        mirror = flip[rows].to(device)[:, None, None]
        scale = (step[rows] / 2**number).to(device)[:, None, None]
        # Pixel of the crop, x right and y up, turned back into the bank.
        x, y = ticks[None, None, :] * mirror, -ticks[None, :, None]
        u = (cosine * x + sine * y) * scale + centre[rows, 0].to(device)[:, None, None] * side
        v = (cosine * y - sine * x) * scale
        v = centre[rows, 1].to(device)[:, None, None] * side - v
        planes = bank[index[rows].to(device)].float()
        planes = functional.pad(planes, (0, 1, 0, 1), mode="circular")
        grid = torch.stack([u.remainder(side), v.remainder(side)], -1) * (2 / side) - 1
        maps = from_planes(functional.grid_sample(planes, grid, mode="bilinear", padding_mode="border", align_corners=True))
        nx, ny = maps[:, 3:4], maps[:, 4:5]
        maps[:, 3:4], maps[:, 4:5] = (
            (cosine * nx.squeeze(1) - sine * ny.squeeze(1)).unsqueeze(1) * mirror[:, None],
            (sine * nx.squeeze(1) + cosine * ny.squeeze(1)).unsqueeze(1),
        )
        out[where] = maps
    return out


class ProceduralPool:
    """The newest `groups` groups of `per_group` procedural materials, one kind a group; every `refresh` steps the oldest is replaced.

    What is in it depends on seed and step alone, so that a run that is resumed sees the same materials.
    """

    def __init__(self, seed, groups, per_group, refresh, size, device):
        self.seed, self.groups, self.per_group, self.refresh, self.size = seed, groups, per_group, refresh, size
        self.bank = torch.zeros(groups * per_group, PLANES, size, size, dtype=torch.float16, device=device)
        self.half = torch.zeros(groups * per_group, PLANES, size // 2, size // 2, dtype=torch.float16, device=device)
        self.made = None

    def levels(self, step):
        """The bank and its half at training step `step`."""
        newest = self.groups + step // self.refresh
        first = newest - self.groups if self.made is None or self.made > newest else max(self.made, newest - self.groups)
        for number in range(first, newest):
            maps = procedural.group(self.seed, number, self.per_group, self.size, self.bank.device)
            place = slice(number % self.groups * self.per_group, (number % self.groups + 1) * self.per_group)
            self.bank[place] = to_planes(maps)
            self.half[place] = halved(self.bank[place])
        self.made = newest
        return [self.bank, self.half]


def draw_crops(rng, levels, count, size):
    """`count` crops of random materials of a bank at random places, angles and scales; three in ten keep the axes of the texture."""

    def uniform(low, high):
        return torch.rand(count, generator=rng) * (high - low) + low

    side = levels[0].shape[-1]
    widest = side / size
    # From twice magnified to the whole texture in one crop, at most 2.8 pixels of the bank to one.
    step = torch.exp(uniform(math.log(0.5), math.log(min(max(widest, 1.0), 2.8))))
    angle = uniform(0, 2 * math.pi)
    upright = torch.rand(count, generator=rng) < 0.3
    angle = torch.where(upright, (angle / (math.pi / 2)).round() * (math.pi / 2), angle)
    centre = torch.rand(count, 2, generator=rng)
    flip = torch.where(torch.rand(count, generator=rng) < 0.5, 1.0, -1.0)
    index = torch.randint(levels[0].shape[0], (count,), generator=rng)
    return sample_crops(levels, index, size, step, angle, centre, flip)
