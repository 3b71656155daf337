"""Captures: where camera and light stand, what a camera makes of the radiance, and what the network gets to see.

Half the width of the patch is the unit of length: a capture covers x and y from -1 to 1.
"""

import math
from dataclasses import dataclass

import torch
import torch.nn.functional as functional

from maps import GAMMA, NORMAL, join, unit
from render import directions, encode_radiance, pixel_positions, render

# Planes of the network's input per photo, see `network_input`.
INPUTS = 13
# Largest encoded ratio to a white diffuse surface that the network is shown.
RATIO_MAX = 4.0


@dataclass
class Geometry:
    """Camera, light and intensity (B, N, 3) of every photo, and positions (B, 3, H, W) of the pixels."""

    camera: torch.Tensor
    light: torch.Tensor
    intensity: torch.Tensor
    position: torch.Tensor


@dataclass
class Capture:
    """Photos (B, N, 3, H, W) as stored, mask of saturated pixels (B, N, 1, H, W), stated geometry, and the true maps."""

    photos: torch.Tensor
    saturated: torch.Tensor
    stated: Geometry
    maps: torch.Tensor


def windows(rng, count, height, width, whole, device):
    """Pixel positions (B, 3, H, W) of the part of the capture that is seen: all of it with probability `whole`, else a tile."""
    share = torch.exp(torch.rand(count, 1, generator=rng) * math.log(0.1))
    share = torch.where(torch.rand(count, 1, generator=rng) < whole, torch.ones(()), share)
    centre = (2 * torch.rand(count, 2, generator=rng) - 1) * (1 - share)
    centre = torch.cat([centre, torch.zeros(count, 1)], 1).to(device)[:, :, None, None]
    return pixel_positions(height, width, device=device) * share.to(device)[:, :, None, None] + centre


def draw_geometry(rng, count, photos, height, width, device, family=None, whole=0.35, collocated=0.75):
    """Stated geometry of `count` captures of `photos` photos.

    Family `near`: distance 2-3, offsets up to 1.2; `real`: distance 3-9, offsets up to 2.4 and 0.45 of the distance; None: both, one to two.
    With probability `collocated` lamp and lens are one (or a few hundredths of the distance apart), else the light stands elsewhere.
    The intensity is such that a white diffuse patch at the centre reads 0.4 to 1.6, one for the whole capture.
    Family `paper`: as the synthetic literature renders them, 2.146 above the patch, offsets up to 1.2, lamp and lens one; white reads 1 straight below.
    """

    def uniform(low, high, *shape):
        return torch.rand(count, *shape, generator=rng) * (high - low) + low

    if family == "paper":
        distance = torch.full((count, photos), 2.146)
        radius, angle = 1.2 * uniform(0, 1, photos).sqrt(), uniform(0, 2 * math.pi, photos)
        camera = torch.stack([radius * torch.cos(angle), radius * torch.sin(angle), distance], -1)
        intensity = torch.full((count, photos, 3), math.pi * 2.146**2)
        return Geometry(camera.to(device), camera.to(device), intensity.to(device), pixel_positions(height, width, device=device).expand(count, 3, height, width))

    near = torch.full((count,), family == "near") if family else torch.rand(count, generator=rng) < 1 / 3
    distance = torch.where(near, uniform(2, 3), torch.exp(uniform(math.log(3), math.log(9))))
    reach = torch.where(near, torch.full_like(distance, 1.2), torch.minimum(0.45 * distance, torch.tensor(2.4)))
    # Hand-held rings are wide or narrow; some captures look straight down.
    reach = reach * uniform(0.4, 1.0)

    def places(straight):
        radius = reach[:, None] * uniform(0, 1, photos).sqrt()
        angle = uniform(0, 2 * math.pi, photos)
        radius = torch.where(straight & (torch.arange(photos) == 0), 0.1 * radius, radius)
        height = distance[:, None] * uniform(0.9, 1.1, photos)
        return torch.stack([radius * torch.cos(angle), radius * torch.sin(angle), height], -1)

    camera = places(uniform(0, 1, 1) < 0.5)
    offset = torch.randn(count, 1, 3, generator=rng) * torch.tensor([0.03, 0.03, 0.01]) * distance[:, None, None]
    beside = camera + offset * (uniform(0, 1, 1, 1) < 0.25)
    apart = uniform(0, 1, 1, 1) >= collocated
    light = torch.where(apart, places(torch.zeros(count, 1, dtype=torch.bool)), beside)
    white = torch.exp(uniform(math.log(0.4), math.log(1.6)))
    distance2 = (light * light).sum(-1)
    irradiance = light[..., 2] / distance2.sqrt() / distance2
    intensity = white / irradiance.mean(1) * math.pi
    intensity = intensity[:, None, None].expand(count, photos, 3).contiguous()
    position = windows(rng, count, height, width, whole, device)
    return Geometry(camera.to(device), light.to(device), intensity.to(device), position)


def tilted(maps, rng):
    """Maps of a sample that leans by up to 9 degrees (normals turned), and by how much its surface rises along x and y."""
    count = len(maps)
    lean = torch.deg2rad(9 * torch.rand(count, generator=rng) ** 1.5) * (torch.rand(count, generator=rng) < 0.7)
    towards = 2 * math.pi * torch.rand(count, generator=rng)
    axis = torch.stack([-torch.sin(towards), torch.cos(towards), torch.zeros(count)], -1).to(maps.device)
    sine, cosine = (function(lean).to(maps.device)[:, None, None, None] for function in (torch.sin, torch.cos))
    axis = axis[:, :, None, None]
    normal = maps[:, NORMAL]
    turned = normal * cosine + torch.cross(axis.expand_as(normal), normal, dim=1) * sine + axis * (axis * normal).sum(1, keepdim=True) * (1 - cosine)
    # A surface whose normal is (sin t cos a, sin t sin a, cos t) falls towards a.
    fall = torch.tan(lean)
    rise = torch.stack([-fall * torch.cos(towards), -fall * torch.sin(towards)], -1)
    # What turned away from the camera is brought back to grazing.
    turned = torch.cat([turned[:, :2], turned[:, 2:].clamp_min(0.02)], 1)
    return join(maps[:, :3], unit(turned), maps[:, 6:7], maps[:, 7:]), rise.to(maps.device)


def clean_photos(maps, geometry):
    """Encoded photos and saturation of a perfect camera with 8 bits."""
    radiance = render(maps, geometry.position, geometry.camera, geometry.light, geometry.intensity)
    photos = (encode_radiance(radiance).clamp(0, 1) * 255).round() / 255
    return photos, (photos.amax(2, keepdim=True) >= 1).to(photos.dtype)


def photograph(maps, geometry, rng, noise_rng):
    """A capture of `maps` by a real camera under the stated `geometry`: everything that goes wrong does so here.

    `rng` draws on the CPU, `noise_rng` pixel noise on the device. Photos are rendered under positions and powers that differ a
    little from the stated ones, of a tilted sample, and suffer vignetting, stray light, blur, misregistration, noise, saturation and 8 bits.
    """
    device = maps.device
    count, photos = geometry.camera.shape[:2]
    height, width = maps.shape[-2:]

    def uniform(low, high, *shape):
        return (torch.rand(count, *shape, generator=rng) * (high - low) + low).to(device)

    def normal(deviation, *shape):
        return (torch.randn(count, *shape, generator=rng) * deviation).to(device)

    maps, rise = tilted(maps, rng)
    stated = geometry
    distance = stated.camera[..., 2:].mean(1, keepdim=True)
    careful = uniform(0, 1, 1, 1) < 0.3
    slack = torch.where(careful, uniform(0, 0, 1, 1), uniform(0, 1, 1, 1))
    moved = normal(0.012, photos, 3) * distance * slack
    lamp = moved + normal(0.004, photos, 3) * distance * slack
    power = torch.exp(normal(0.06, 1, 1) * slack + normal(0.02, 1, 3) * slack + normal(0.03, photos, 1) * slack)
    x, y = stated.position[:, :1], stated.position[:, 1:2]
    z = rise[:, 0, None, None, None] * x + rise[:, 1, None, None, None] * y
    position = torch.cat([x, y, z], 1)
    radiance = render(maps, position, stated.camera + moved, stated.light + lamp, stated.intensity * power)

    # Whoever takes the photos exposes so that at most a fifth of the picture is saturated, mostly.
    bright = torch.quantile(radiance[..., ::4, ::4].amax(2).flatten(1), 0.8, dim=1)
    darker = torch.where(uniform(0, 1) < 0.9, bright.clamp_min(1).reciprocal(), torch.ones_like(bright))[:, None, None]
    radiance = radiance * darker[..., None, None]
    stated = Geometry(stated.camera, stated.light, stated.intensity * darker, stated.position)

    # Vignetting of lens and lamp grows with the distance from the centre of the capture.
    radius2 = (x * x + y * y)[:, None] / 2
    fade = uniform(0, 0.25, 1, 1, 1, 1) * (uniform(0, 1, 1, 1, 1, 1) < 0.5)
    radiance = radiance * (1 - fade * radius2)
    # Stray light: the room's, reflected by the diffuse albedo, and flare.
    white = (stated.intensity / distance**2 / math.pi).mean(1)[:, None, :, None, None]
    stray = uniform(0, 0.015, 1, 1, 1, 1) * (uniform(0, 1, 1, 1, 1, 1) < 0.4)
    radiance = radiance + stray * white * (maps[:, None, :3] * 0.8 + 0.2 * uniform(0, 1, 1, 1, 1, 1))

    # Misregistration: each photo shifted, turned and scaled by up to a pixel, which also blurs a little.
    flat = radiance.reshape(count * photos, 3, height, width)
    apart = (slack[..., None, None] * uniform(0, 1, 1, 1, 1, 1)).expand(count, photos, 1, 1, 1).reshape(-1, 1, 1)
    shift = (torch.randn(count * photos, 2, 3, generator=rng) * torch.tensor([0.4, 0.4, 0.5])).to(device) * apart * (2 / width)
    theta = torch.eye(2, 3, device=device) + shift
    grid = functional.affine_grid(theta, flat.shape, align_corners=False)
    flat = functional.grid_sample(flat, grid, mode="bilinear", padding_mode="border", align_corners=False)
    # Blur of lens and resampling: three taps, weight up to that of a deviation of 0.7 pixels.
    tap = (uniform(0, 0.22, 1, 1, 1, 1) * (uniform(0, 1, 1, 1, 1, 1) < 0.5)).expand(count, photos, 1, 1, 1).reshape(-1, 1, 1, 1)
    flat = functional.pad(flat, (1, 1, 1, 1), mode="replicate")
    flat = flat[..., 1:-1] * (1 - 2 * tap) + tap * (flat[..., :-2] + flat[..., 2:])
    flat = flat[..., 1:-1, :] * (1 - 2 * tap) + tap * (flat[..., :-2, :] + flat[..., 2:, :])
    radiance = flat.reshape(count, photos, 3, height, width)

    shot = torch.exp(uniform(math.log(1e-3), math.log(1.5e-2), 1, 1, 1, 1))
    read = torch.exp(uniform(math.log(2e-4), math.log(3e-3), 1, 1, 1, 1))
    noise = torch.randn(radiance.shape, generator=noise_rng, device=device)
    radiance = radiance + noise * (shot * shot * radiance.clamp(0, 1) + read * read).sqrt()
    pictures = (encode_radiance(radiance.clamp_min(0)).clamp(0, 1) * 255).round() / 255
    saturated = (pictures.amax(2, keepdim=True) >= 1).to(pictures.dtype)
    # In a photo made smaller, pixels count as saturated that are so in part.
    wider = functional.max_pool2d(saturated.flatten(0, 1), 3, 1, 1).reshape(saturated.shape)
    saturated = torch.where(uniform(0, 1, 1, 1, 1, 1) < 0.3, wider, saturated)
    return Capture(pictures, saturated, stated, maps)


def network_input(photos, saturated, geometry, directions_known=True):
    """What the network sees of every photo, (B, N, 13, H, W).

    Planes: the photo as stored (gamma 2.2), 3; the gamma 2.2 encoding of its ratio to what a white diffuse patch facing +z would show
    under the stated light, 3, at most 4 (for a matt surface this is the code of its albedo times its shading); saturation, 1;
    direction to the light, 3; half vector, 3. The half vector tells what the view direction would, and where the highlight lies. `directions_known=False` leaves
    the planes that follow from positions 0.
    """
    if not directions_known:
        empty = torch.zeros_like(photos)
        return torch.cat([photos, empty, saturated, empty, empty], 2)
    view, light_dir, half, distance2 = directions(geometry.position, geometry.camera, geometry.light)
    white = geometry.intensity[..., None, None] / distance2 * light_dir[..., 2:3, :, :].clamp_min(0) / math.pi
    ratio = (photos.clamp_min(0) ** GAMMA / white.clamp_min(1e-4)).clamp(1e-6, RATIO_MAX**GAMMA) ** (1 / GAMMA)
    return torch.cat([photos, ratio, saturated, light_dir, half], 2)
