"""The training loss: maps, re-renderings, certainty."""

import math

import torch

from .maps import RAW_DIFFUSE, RAW_NORMAL, RAW_ROUGHNESS, RAW_SPECULAR, decode_maps, encode_maps
from .render import compress_radiance, pixel_positions, render

GROUPS = {"diffuse": RAW_DIFFUSE, "normal": RAW_NORMAL, "roughness": RAW_ROUGHNESS, "specular": RAW_SPECULAR}


def map_errors(raw, target):
    """Absolute differences of raw maps in units of the encoded maps: albedos and roughness over 2, normal x and y as they are."""
    unit = torch.full((9, 1, 1), 0.5, device=raw.device, dtype=raw.dtype)
    unit[RAW_NORMAL] = 1
    return (raw - target).abs() * unit


def losses(raw, log_sigma, maps, views, settings, roughness_floor):
    """The total and its parts, tensors without synchronisation. `views` (B, V, 3, 3): camera, light and intensity under which renderings are compared.

    `log_sigma` is None where a network does not say how sure it is.
    """
    target = encode_maps(maps)
    errors = map_errors(raw, target)
    parts = {name: errors[:, group].mean() for name, group in GROUPS.items()}
    parts["maps"] = sum(parts[name] for name in GROUPS) / len(GROUPS)

    position = pixel_positions(*maps.shape[-2:], device=maps.device, dtype=maps.dtype)[None]
    camera, light, intensity = views.unbind(2)
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
