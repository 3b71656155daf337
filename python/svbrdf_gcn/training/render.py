"""The shading model of docs/conventions.md (isotropic) in PyTorch; gradients come from autograd."""

import math

import torch

from .maps import DIFFUSE, GAMMA, NORMAL, ROUGHNESS, SPECULAR, unit

# Roughness below this renders as this.
ROUGHNESS_MIN = 1e-3


def pixel_positions(height, width, patch_size=2.0, device=None, dtype=torch.float32):
    """Positions (3, H, W) of the pixels of a patch `patch_size` wide in the plane z = 0; row 0 is at +y."""
    x = ((torch.arange(width, device=device, dtype=dtype) + 0.5) / width - 0.5) * patch_size
    y = -((torch.arange(height, device=device, dtype=dtype) + 0.5) / height - 0.5) * patch_size * height / width
    x, y = x.expand(height, width), y[:, None].expand(height, width)
    return torch.stack([x, y, torch.zeros_like(x)])


def directions(position, camera, light):
    """Unit vectors to camera and light, the half vector, and the squared distance to the light.

    `position` (B, 3, H, W) or (B, N, 3, H, W); `camera` and `light` (B, N, 3). Returns (B, N, 3, H, W) and, the last, (B, N, 1, H, W).
    """
    if position.dim() == 4:
        position = position[:, None]
    to_light = light[..., None, None] - position
    view, light_dir = unit(camera[..., None, None] - position), unit(to_light)
    return view, light_dir, unit(view + light_dir), (to_light * to_light).sum(-3, keepdim=True)


def shade(maps, view, light_dir, half, irradiance):
    """Radiance (B, N, 3, H, W) of maps (B, 10, H, W) or (B, N, 10, H, W), given directions and `irradiance` = intensity / distance^2."""
    if maps.dim() == 4:
        maps = maps[:, None]
    diffuse, specular = maps[..., DIFFUSE, :, :], maps[..., SPECULAR, :, :]
    normal = unit(maps[..., NORMAL, :, :])
    # At the bound itself the slope is 1, whatever this version's clamp thinks of it.
    roughness = maps[..., ROUGHNESS, :, :]
    alpha = torch.where(roughness < ROUGHNESS_MIN, torch.full_like(roughness, ROUGHNESS_MIN), roughness) ** 2

    def dot(a, b):
        return (a * b).sum(-3, keepdim=True)

    n_dot_l, n_dot_v = dot(normal, light_dir), dot(normal, view)
    lit = (n_dot_l > 0) & (n_dot_v > 0)
    n_dot_l, n_dot_v = n_dot_l.clamp(0, 1), n_dot_v.clamp(0, 1)
    # |n x h|^2 instead of 1 - (n.h)^2, which cancels.
    nx, ny, nz = normal.unbind(-3)
    hx, hy, hz = half.unbind(-3)
    sin2 = ((ny * hz - nz * hy) ** 2 + (nz * hx - nx * hz) ** 2 + (nx * hy - ny * hx) ** 2).unsqueeze(-3).clamp_max(1)
    # GGX as (alpha / q)^2 / pi with q = sin^2 + cos^2 alpha^2, both terms positive.
    ratio = alpha / (sin2 * ((1 - alpha) * (1 + alpha)) + alpha * alpha)
    k = alpha / 2
    # D G / (4 n.v n.l) n.l: the cosines of the denominator cancel against G.
    lobe = ratio * ratio / math.pi * 0.25 * n_dot_l / ((n_dot_v * (1 - k) + k) * (n_dot_l * (1 - k) + k))
    v_dot_h = dot(view, half).clamp(0, 1)
    fresnel = specular + (1 - specular) * torch.exp2((-5.55473 * v_dot_h - 6.98316) * v_dot_h)
    radiance = (diffuse * (1 - specular) / math.pi * n_dot_l + fresnel * lobe) * irradiance
    return torch.where(lit, radiance, torch.zeros_like(radiance))


def render(maps, position, camera, light, intensity):
    """Radiance (B, N, 3, H, W). `intensity` (B, N, 3); the rest as in `directions` and `shade`."""
    view, light_dir, half, distance2 = directions(position, camera, light)
    return shade(maps, view, light_dir, half, intensity[..., None, None] / distance2)


def encode_radiance(radiance):
    """Gamma 2.2 with a finite slope at 0: below 1e-6 a line."""
    toe = 1e-6
    return torch.where(radiance > toe, radiance.clamp_min(toe) ** (1 / GAMMA), radiance * (toe ** (1 / GAMMA) / toe))


def compress_radiance(radiance):
    """For losses: gamma 2.2 up to 1, the logarithm that continues it with the same slope above."""
    encoded = encode_radiance(radiance.clamp_max(1))
    return encoded + radiance.clamp_min(1).log() / GAMMA
