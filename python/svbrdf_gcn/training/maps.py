"""Material maps as tensors, and how they are encoded.

Maps are (..., 10, H, W), linear: diffuse albedo 3, normal 3 (+x right, +y up, +z out, unit), roughness 1 (perceptual), specular albedo 3 (F0).
Raw planes are what the network's adapters put out, (..., 9, H, W) in [-1, 1]: diffuse 3, normal x and y, roughness 1, specular 3.
"""

import torch

GAMMA = 2.2
DIFFUSE, NORMAL, ROUGHNESS, SPECULAR = slice(0, 3), slice(3, 6), slice(6, 7), slice(7, 10)
RAW_DIFFUSE, RAW_NORMAL, RAW_ROUGHNESS, RAW_SPECULAR = slice(0, 3), slice(3, 5), slice(5, 6), slice(6, 9)
# Largest x^2 + y^2 of a decoded normal.
FLAT_LIMIT = 1 - 1e-6


def join(diffuse, normal, roughness, specular):
    """Maps from their parts."""
    return torch.cat([diffuse, normal, roughness, specular], -3)


def unit(vectors, dim=-3):
    """Vectors of length 1 along `dim`; a vector of length 0 stays 0."""
    return vectors * (vectors * vectors).sum(dim, keepdim=True).clamp_min(1e-30).rsqrt()


def normal_from_slopes(x, y):
    """Unit normals of a surface whose height rises by `x` to the right and `y` upwards, per unit of length."""
    return unit(torch.cat([-x, -y, torch.ones_like(x)], -3))


def slopes_from_normal(normal):
    """Inverse of `normal_from_slopes`; grazing normals are limited to a slope of 10."""
    z = normal[..., 2:3, :, :].clamp_min(0.1)
    return -normal[..., 0:1, :, :] / z, -normal[..., 1:2, :, :] / z


def encode_maps(maps):
    """Raw planes of maps: `decode_maps` gives the maps back."""

    def power(values):
        return 2 * values.clamp(0, 1) ** (1 / GAMMA) - 1

    parts = [power(maps[..., DIFFUSE, :, :]), maps[..., 3:5, :, :]]
    return torch.cat([*parts, power(maps[..., ROUGHNESS, :, :]), power(maps[..., SPECULAR, :, :])], -3)


def decode_maps(raw, roughness_floor):
    """Maps of raw planes; raw roughness below `roughness_floor` decodes as that.

    The slope of the power law is finite everywhere; values outside of [floor, 1] have no gradient.
    """

    def power(values, floor=-1.0):
        return ((values.clamp(floor, 1) + 1) / 2) ** GAMMA

    xy = raw[..., RAW_NORMAL, :, :]
    length2 = (xy * xy).sum(-3, keepdim=True)
    xy = xy * (FLAT_LIMIT / length2.clamp_min(FLAT_LIMIT)).sqrt()
    z = (1 - (xy * xy).sum(-3, keepdim=True)).clamp_min(1 - FLAT_LIMIT).sqrt()
    roughness = power(raw[..., RAW_ROUGHNESS, :, :], roughness_floor)
    return join(power(raw[..., RAW_DIFFUSE, :, :]), torch.cat([xy, z], -3), roughness, power(raw[..., RAW_SPECULAR, :, :]))
