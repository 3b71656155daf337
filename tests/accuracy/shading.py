"""The shading model of docs/conventions.md in numpy, written apart from the Rust code so that it checks it."""

from dataclasses import dataclass

import numpy as np

GAMMA = 2.2
# Roughness below this renders as this.
ROUGHNESS_MIN = 1e-3


@dataclass(frozen=True)
class Maps:
    """Linear maps: `diffuse` and `specular` (H, W, 3), `roughness` (H, W, 1), perceptual, `normal` (H, W, 3), unit, +x right, +y up.

    Where lobes are not round, `tangent` (H, W, 3) and two roughnesses, along and across it.
    """

    diffuse: np.ndarray
    normal: np.ndarray
    roughness: np.ndarray
    specular: np.ndarray
    tangent: np.ndarray | None = None

    @property
    def mean_roughness(self):
        """The geometric mean of both roughnesses, (H, W, 1)."""
        return np.sqrt(self.roughness[..., :1] * self.roughness[..., -1:])


def gamma22(linear):
    """Linear values, clamped to [0, 1], in gamma 2.2."""
    return np.clip(linear, 0, 1) ** (1 / GAMMA)


def unit(vectors):
    """Vectors of length 1 along the last axis."""
    return vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-30)


def pixel_positions(height, width, patch_size):
    """Positions (H, W, 3) of pixels in the plane z = 0; row 0 is at +y."""
    x = ((np.arange(width) + 0.5) / width - 0.5) * patch_size
    y = -((np.arange(height) + 0.5) / height - 0.5) * patch_size * height / width
    return np.stack([*np.meshgrid(x, y), np.zeros((height, width))], -1)


def render(maps, camera, light, intensity, patch_size):
    """Radiance (H, W, 3), linear, not clamped. `camera`, `light`: positions; `intensity`: RGB, in photo units times length squared."""
    place = pixel_positions(*maps.diffuse.shape[:2], patch_size)
    to_light = np.asarray(light, np.float64) - place
    view, light_dir = unit(np.asarray(camera, np.float64) - place), unit(to_light)
    half, normal = unit(view + light_dir), unit(maps.normal.astype(np.float64))

    def dot(a, b):
        return (a * b).sum(-1, keepdims=True)

    n_dot_l, n_dot_v, n_dot_h, v_dot_h = dot(normal, light_dir), dot(normal, view), dot(normal, half), dot(view, half)
    lit = (n_dot_l > 0) & (n_dot_v > 0)
    alpha = np.maximum(maps.roughness.astype(np.float64), ROUGHNESS_MIN) ** 2
    if maps.tangent is None:
        sine = np.cross(normal, half)
        distribution = alpha**2 / (np.pi * (dot(sine, sine) + n_dot_h**2 * alpha**2) ** 2)
        k = alpha / 2
        # G / (n.v n.l): the cosines cancel.
        masking = 1 / ((n_dot_v * (1 - k) + k) * (n_dot_l * (1 - k) + k))
    else:
        tangent = maps.tangent.astype(np.float64)
        tangent = unit(tangent - normal * dot(normal, tangent))
        bitangent = np.cross(normal, tangent)
        along, across = alpha[..., :1], alpha[..., 1:]
        stretched = (dot(tangent, half) / along) ** 2 + (dot(bitangent, half) / across) ** 2 + n_dot_h**2
        distribution = 1 / (np.pi * along * across * stretched**2)

        def smith(direction, cosine):
            return 2 / (cosine + np.sqrt((along * dot(tangent, direction)) ** 2 + (across * dot(bitangent, direction)) ** 2 + cosine**2))

        masking = smith(view, n_dot_v) * smith(light_dir, n_dot_l)
    fresnel = maps.specular + (1 - maps.specular) * 2 ** ((-5.55473 * v_dot_h - 6.98316) * v_dot_h)
    reflectance = maps.diffuse * (1 - maps.specular) / np.pi + fresnel * distribution * np.where(lit, masking, 0) / 4
    return np.where(lit, reflectance * n_dot_l * np.asarray(intensity) / dot(to_light, to_light), 0)
