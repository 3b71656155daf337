"""Variation of sampled crops (B, 10, H, W): everything is drawn per material."""

import math

import torch
import torch.nn.functional as functional

from maps import join, normal_from_slopes, slopes_from_normal


class Dice:
    """Random values per material, drawn on the CPU and sent to `device`."""

    def __init__(self, rng, count, device):
        self.rng, self.count, self.device = rng, count, device

    def uniform(self, low, high, channels=1):
        return (torch.rand(self.count, channels, 1, 1, generator=self.rng) * (high - low) + low).to(self.device)

    def normal(self, deviation, channels=1):
        return (torch.randn(self.count, channels, 1, 1, generator=self.rng) * deviation).to(self.device)

    def chance(self, probability):
        return (torch.rand(self.count, 1, 1, 1, generator=self.rng) < probability).to(self.device)

    def smooth(self, cells, height, width, channels=1):
        """Smooth random fields with mean 0 and deviation about 1, `cells` bumps across."""
        coarse = torch.randn(self.count, channels, cells + 3, cells + 3, generator=self.rng).to(self.device)
        return functional.interpolate(coarse, (height, width), mode="bicubic", align_corners=True)


def hue_turned(color, angle, gain):
    """Linear RGB turned about the grey axis by `angle`, times `gain`, not below 0."""
    cosine, sine = torch.cos(angle), torch.sin(angle)
    grey = color.mean(1, keepdim=True)
    r, g, b = color.split(1, 1)
    cross = torch.cat([b - g, r - b, g - r], 1) / 3**0.5
    return ((color * cosine + cross * sine + grey * (1 - cosine)) * gain).clamp_min(0)


def recolour(maps, dice):
    """Hue, saturation, brightness and contrast of the albedos."""
    diffuse, normal, roughness, specular = maps.split([3, 3, 1, 3], 1)
    changed = dice.chance(0.6)
    angle = torch.where(dice.chance(0.4), dice.uniform(-3.1416, 3.1416), dice.normal(0.1))
    saturation = dice.uniform(0.0, 1.5)
    gain = torch.exp(dice.normal(0.4)) * torch.exp(dice.normal(0.08, 3))

    def change(color, gain):
        color = hue_turned(color, angle, 1.0)
        grey = color.mean(1, keepdim=True)
        return ((grey + saturation * (color - grey)) * gain).clamp(0, 1)

    mean = diffuse.mean((1, 2, 3), keepdim=True).clamp_min(1e-3)
    contrast = torch.exp(dice.normal(0.2))
    recoloured = change(mean * (diffuse / mean).clamp_min(1e-4) ** contrast, gain).clamp_max(0.95)
    # Metals keep their brightness; dielectrics have no hue to turn.
    tinted = change(specular, torch.ones_like(gain))
    return join(torch.where(changed, recoloured, diffuse), normal, roughness, torch.where(changed, tinted, specular))


def respecular(maps, dice):
    """Strength and tint of the specular albedo, and conversions to metal."""
    diffuse, normal, roughness, specular = maps.split([3, 3, 1, 3], 1)
    strength = torch.where(dice.chance(0.5), dice.uniform(0.6, 1.4), torch.exp(dice.normal(0.6)))
    tint = torch.where(dice.chance(0.3), dice.uniform(0.6, 1.0, 3), dice.uniform(1, 1, 3))
    scaled = (specular * strength * tint).clamp(0.01, 1)
    # Coats of other strengths over the diffuse albedo: libraries of dielectrics hold 0.04 alone.
    dielectric = 1 - ((specular.mean(1, keepdim=True) - 0.05) / 0.15).clamp(0, 1)
    coat = torch.exp(dice.uniform(math.log(0.02), math.log(0.3))) * tint
    scaled = scaled + dielectric * dice.chance(0.25) * (coat - scaled)
    # The pattern of the diffuse albedo carried over into a metal's reflectance.
    metal = (diffuse / diffuse.amax((1, 2, 3), keepdim=True).clamp_min(0.02) * dice.uniform(0.4, 1.0)).clamp(0.04, 1)
    amount = torch.where(dice.chance(0.08), torch.where(dice.chance(0.7), dice.uniform(1, 1), dice.uniform(0, 1)), dice.uniform(0, 0))
    was_metal = (specular.mean((1, 2, 3), keepdim=True) > 0.2).float()
    amount = amount * (1 - was_metal)
    return join(diffuse * (1 - amount), normal, roughness, scaled + amount * (metal - scaled))


def reroughen(maps, dice):
    """Level, contrast and direction of roughness."""
    diffuse, normal, roughness, specular = maps.split([3, 3, 1, 3], 1)
    mean = roughness.mean((2, 3), keepdim=True)
    contrast = torch.exp(dice.normal(0.4)) * torch.where(dice.chance(0.1), dice.uniform(-1, -1), dice.uniform(1, 1))
    level = torch.where(dice.chance(0.45), dice.uniform(0.1, 0.8), mean + dice.normal(0.08))
    changed = level + (roughness - mean) * contrast
    roughness = torch.where(dice.chance(0.7), changed, roughness).clamp(0.07, 1)
    return join(diffuse, normal, roughness, specular)


def rebump(maps, dice):
    """Normals strengthened or flattened, and gentle undulation as of cloth or a warped board."""
    diffuse, normal, roughness, specular = maps.split([3, 3, 1, 3], 1)
    x, y = slopes_from_normal(normal)
    rms = (x * x + y * y).mean((2, 3), keepdim=True).sqrt().clamp_min(1e-3)
    factor = torch.exp(dice.normal(0.5))
    # One in four is brought to a drawn strength: most photographed libraries are too flat.
    factor = torch.where(dice.chance(0.25), torch.exp(dice.uniform(-3.2, -0.6)) / rms, factor).clamp(0.1, 8.0)
    factor = torch.where(dice.chance(0.7), factor, dice.uniform(1, 1)).clamp_max(0.9 / rms)
    height, width = maps.shape[-2:]
    wave = dice.smooth(3, height, width, 2) * dice.uniform(0, 0.08) * dice.chance(0.3)
    x, y = ((slope * factor).clamp(-3, 3) + wave[:, i : i + 1] for i, slope in enumerate((x, y)))
    return join(diffuse, normal_from_slopes(x, y), roughness, specular)


def mixed(maps, other, dice):
    """One in four materials is mixed with the one of the same place in `other`: by a mask with soft or hard edges, or evenly."""
    height, width = maps.shape[-2:]
    field = torch.where(dice.chance(0.5), dice.smooth(2, height, width), dice.smooth(9, height, width))
    # The relief of the first material may decide where the second lies: in the dents or on the tops.
    brightness = maps[:, :3].mean(1, keepdim=True)
    brightness = (brightness - brightness.mean((2, 3), keepdim=True)) / brightness.std((2, 3), keepdim=True).clamp_min(1e-3)
    field = field + dice.uniform(0, 1.5) * dice.chance(0.4) * brightness
    mask = ((field - dice.uniform(-1.0, 1.0)) / torch.exp(dice.uniform(-4.6, 0.0)) + 0.5).clamp(0, 1)
    mask = torch.where(dice.chance(0.3), dice.uniform(0.2, 0.8), mask) * dice.chance(0.25)
    parts = maps + mask * (other - maps)
    xs, ys = zip(slopes_from_normal(maps[:, 3:6]), slopes_from_normal(other[:, 3:6]))
    x, y = (a + mask * (b - a) for a, b in (xs, ys))
    return join(parts[:, :3], normal_from_slopes(x, y), parts[:, 6:7], parts[:, 7:])


def augmented(maps, rng):
    """Crops varied in every way of this module."""
    dice = Dice(rng, len(maps), maps.device)
    maps = rebump(reroughen(respecular(recolour(maps, dice), dice), dice), dice)
    return mixed(maps, maps[torch.randperm(len(maps), generator=rng).to(maps.device)], dice)
