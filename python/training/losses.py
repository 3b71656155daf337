"""The training loss: maps, re-renderings, certainty."""

import math

import torch

from maps import RAW_DIFFUSE, RAW_NORMAL, RAW_ROUGHNESS, RAW_SPECULAR, decode_maps, encode_maps
from render import compress_radiance, pixel_positions, render

GROUPS = {"diffuse": RAW_DIFFUSE, "normal": RAW_NORMAL, "roughness": RAW_ROUGHNESS, "specular": RAW_SPECULAR}


def draw_views(rng, count, views):
    """Camera, light and intensity (B, V, 3) under which renderings are compared, for a patch from -1 to 1.

    One in three has camera and light together above the patch; the others lie such that a random point of it reflects the light
    into the camera: there specular and roughness show.
    """

    def uniform(low, high, *shape):
        return torch.rand(count, views, *shape, generator=rng) * (high - low) + low

    distance = torch.exp(uniform(math.log(2), math.log(6), 1))
    radius, angle = 0.5 * distance * uniform(0, 1, 1).sqrt(), uniform(0, 2 * math.pi, 1)
    together = torch.cat([radius * torch.cos(angle), radius * torch.sin(angle), distance], -1)
    point = torch.cat([uniform(-0.9, 0.9, 2), torch.zeros(count, views, 1)], -1)
    height, around = uniform(0.3, 1, 1), uniform(0, 2 * math.pi, 1)
    flat = (1 - height * height).sqrt()
    direction = torch.cat([flat * torch.cos(around), flat * torch.sin(around), height], -1)
    mirrored = direction * torch.tensor([-1.0, -1.0, 1.0])
    same = (torch.arange(views) % 3 == 0)[None, :, None]
    camera = torch.where(same, together, point + mirrored * torch.exp(uniform(math.log(2), math.log(6), 1)))
    light = torch.where(same, together, point + direction * distance)
    intensity = math.pi * torch.exp(uniform(math.log(0.4), math.log(2), 1)) * distance**2
    return camera, light, intensity.expand(count, views, 3)


def map_errors(raw, target):
    """Absolute differences of raw maps in units of the encoded maps: albedos and roughness over 2, normal x and y as they are."""
    unit = torch.full((9, 1, 1), 0.5, device=raw.device, dtype=raw.dtype)
    unit[RAW_NORMAL] = 1
    return (raw - target).abs() * unit


def losses(raw, log_sigma, maps, rng, settings, roughness_floor):
    """The total and its parts, tensors without synchronisation. `log_sigma` is None where a network does not say how sure it is."""
    target = encode_maps(maps)
    errors = map_errors(raw, target)
    parts = {name: errors[:, group].mean() for name, group in GROUPS.items()}
    parts["maps"] = sum(parts[name] for name in GROUPS) / len(GROUPS)

    count, _, height, width = maps.shape
    views = (tensor.to(maps) for tensor in draw_views(rng, count, settings["views"]))
    position = pixel_positions(height, width, device=maps.device, dtype=maps.dtype)[None]
    camera, light, intensity = views
    predicted = decode_maps(raw, roughness_floor)
    with torch.no_grad():
        truth = compress_radiance(render(maps, position, camera, light, intensity))
    parts["rendering"] = (compress_radiance(render(predicted, position, camera, light, intensity)) - truth).abs().mean()

    parts["certainty"] = torch.zeros_like(parts["maps"]) if log_sigma is None else certainty(raw, log_sigma, target, roughness_floor)
    parts["loss"] = sum(settings[name] * parts[name] for name in ("maps", "rendering", "certainty"))
    return parts


def certainty(raw, log_sigma, target, roughness_floor):
    """Laplace's likelihood of errors whose mean is sqrt(2 / pi) sigma, as for a Gaussian: sigma covers about two thirds."""
    with torch.no_grad():
        limits = torch.cat([raw[:, :3].clamp(-1, 1), raw[:, 3:5], raw[:, 5:6].clamp(roughness_floor, 1), raw[:, 6:].clamp(-1, 1)], 1)
        errors = map_errors(limits, target)
    return (errors * math.sqrt(math.pi / 2) * torch.exp(-log_sigma) + log_sigma).mean()
