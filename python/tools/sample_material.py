"""The materials of the sample captures, as maps computed in numpy: glazed tiles with a brass inlay, brushed steel, a matt surface.

Four tiles in the cuerda seca technique on a 10 cm patch that repeats seamlessly: pools of coloured glaze between dry dark lines, an
eight-pointed star around a turned brass stud, unglazed terracotta corners, rough recessed grout. Every reflectance parameter varies
for a reason that can be seen: gloss and colour of the glazes, metal against dielectric, grooves, domes and wavy surfaces in the normals.
"""

from dataclasses import dataclass

import numpy as np

PATCH_SIZE = 10.0
TILE = 5.0
OVERSAMPLING = 4
SEED = 20240607


@dataclass
class Maps:
    """(H, W, C) float64 maps, row 0 at the top (+y), all linear; a metallic-roughness material.

    `base_color` (3), `metallic` (1), `dielectric_f0` (1), `roughness` (1, perceptual; 2 where lobes are stretched: along the tangent and across),
    `normal` (3, unit, +x right, +y up, +z out), `tangent` (3, unit, at right angles to the normal; None where lobes are round).
    """

    base_color: np.ndarray
    metallic: np.ndarray
    dielectric_f0: np.ndarray
    roughness: np.ndarray
    normal: np.ndarray
    tangent: np.ndarray | None = None

    @property
    def diffuse_albedo(self):
        return self.base_color * (1 - self.metallic)

    @property
    def specular_albedo(self):
        return self.dielectric_f0 * (1 - self.metallic) + self.base_color * self.metallic


def tiles(size):
    """The tile material, `size` x `size`: evaluated on a grid OVERSAMPLING times finer and averaged."""
    fine = size * OVERSAMPLING
    texel = PATCH_SIZE / fine
    rng = np.random.default_rng(SEED)
    across = (np.arange(fine) + 0.5) * texel
    x, y = np.meshgrid(across, PATCH_SIZE - across)
    # The grid of tiles is moved so that the patch shows one whole tile, and mirror images cannot be mistaken for each other.
    u, v = x + 1.1, y + 1.6
    column, row = np.floor(u / TILE).astype(int) % 2, np.floor(v / TILE).astype(int) % 2
    u, v = (u % TILE) - TILE / 2, (v % TILE) - TILE / 2
    radius = np.hypot(u, v)

    # Signed distances in cm, negative inside, from the outermost part to the innermost.
    body = rounded_square(u, v, 2.36, 0.22)
    corner = np.hypot(np.abs(u) - TILE / 2, np.abs(v) - TILE / 2) - 1.0
    star = eight_pointed_star(u, v, 1.42)
    flower = eight_pointed_star(*rotated(u, v, np.pi / 8), 0.86)
    stud = radius - 0.6

    ground = np.array([[[0.018, 0.055, 0.26], [0.016, 0.19, 0.145]], [[0.30, 0.022, 0.028], [0.018, 0.055, 0.26]]])[row, column]
    color, roughness = ground, np.array([[0.20, 0.25], [0.30, 0.20]])[row, column][..., None]
    f0, metallic = np.full_like(roughness, 0.05), np.zeros_like(roughness)

    def lay(distance, new_color, new_roughness, new_f0=0.05, new_metallic=0.0):
        """Cover what lies inside `distance` with another substance."""
        nonlocal color, roughness, f0, metallic
        inside = (distance < 0)[..., None]
        color, roughness = np.where(inside, new_color, color), np.where(inside, new_roughness, roughness)
        f0, metallic = np.where(inside, new_f0, f0), np.where(inside, new_metallic, metallic)

    lay(corner, [0.40, 0.135, 0.065], 0.68, 0.04)
    lay(star, [0.74, 0.66, 0.50], 0.36)
    lay(flower, [0.66, 0.33, 0.045], 0.27)
    # Glaze pools unevenly: thicker glaze is deeper in colour, and its gloss drifts.
    drift = noise(rng, fine, 1.2)[..., None]
    color, roughness = color * (1 + 0.12 * drift), roughness * (1 + 0.10 * noise(rng, fine, 0.7)[..., None])
    to_line = np.minimum.reduce([np.abs(corner), np.abs(star), np.abs(flower)])
    lay(to_line - 0.05, [0.035, 0.028, 0.024], 0.75, 0.04)
    lay(stud, [0.87, 0.64, 0.30], 0.30 + 0.05 * noise(rng, fine, 0.3)[..., None], 0.04, 1.0)
    grit = noise(rng, fine, 0.05)
    lay(-body, np.array([0.33, 0.30, 0.255]) * (1 + 0.10 * grit[..., None]), 0.88, 0.03)

    # Height in cm: the tile's pillow edge, domed pools of glaze, wavy glaze, the stud's turned grooves, gritty grout.
    depth = np.maximum(-body, 0)
    height = 0.06 * (1 - np.exp(-depth / 0.22)) + 0.004 * noise(rng, fine, 0.45)
    glazed = (corner > 0) & (stud > 0.03)
    height += np.where(glazed, 0.02 * (1 - np.exp(-np.maximum(to_line - 0.05, 0) / 0.10)), 0)
    height += np.where(corner < 0, 0.002 * noise(rng, fine, 0.12), 0)
    dome = np.sqrt(np.maximum(1.6**2 - radius**2, 0)) - np.sqrt(1.6**2 - 0.6**2)
    height = np.where(stud < 0, height.mean() + 0.03 + 0.55 * dome + 0.0018 * np.sin(2 * np.pi * radius / 0.2), height)
    height = np.where(body > 0, 0.0035 * grit, height)
    height = blurred(height, 0.035 / texel)
    normal = averaged(normals(height, texel))
    return Maps(
        base_color=averaged(color),
        metallic=averaged(metallic),
        dielectric_f0=averaged(f0),
        roughness=averaged(roughness),
        normal=unit(normal),
    )


def brushed(size):
    """Brushed steel on a gently buckled plate: the brushing turns by some twenty degrees over the patch."""
    rng = np.random.default_rng(SEED + 1)
    across = 2 * np.pi * (np.arange(size) + 0.5) / size
    x, y = np.meshgrid(across, across[::-1])
    ones = np.ones((size, size, 1))
    angle = 0.45 + 0.18 * np.sin(x) + 0.12 * np.cos(y)
    normal = normals(0.05 * noise(rng, size, 2.5), PATCH_SIZE / size)
    along = np.stack([np.cos(angle), np.sin(angle), 0 * angle], -1)
    wear = noise(rng, size, 0.25)[..., None]
    return Maps(
        base_color=np.array([0.62, 0.60, 0.57]) * (1 + 0.05 * wear),
        metallic=ones,
        dielectric_f0=0.04 * ones,
        # Squared: alpha 0.06 along the brushing, 0.36 across.
        roughness=np.sqrt([0.06, 0.36]) * (1 + 0.03 * noise(rng, size, 1.5)[..., None]),
        normal=normal,
        tangent=unit(along - normal * (along * normal).sum(-1, keepdims=True)),
    )


def normals(height, texel):
    """Of a surface whose heights repeat; `texel` is the width of a pixel in their unit."""
    slope_x = (np.roll(height, -1, 1) - np.roll(height, 1, 1)) / (2 * texel)
    slope_y = (np.roll(height, 1, 0) - np.roll(height, -1, 0)) / (2 * texel)
    return unit(np.stack([-slope_x, -slope_y, np.ones_like(height)], -1))


def unit(vectors):
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


def lambertian(size):
    """A matt surface whose albedo drifts smoothly between 0.1 and 0.8, each colour in its own direction; no step that a photo would blur."""
    across = 2 * np.pi * (np.arange(size) + 0.5) / size
    x, y = np.meshgrid(across, across[::-1])
    ones = np.ones((size, size, 1))
    return Maps(
        base_color=0.45 + 0.35 * np.sin(np.stack([x + 0.5, y + 1.0, x + y + 2.0], -1)),
        metallic=0 * ones,
        dielectric_f0=0 * ones,
        roughness=ones,
        normal=ones * [0.0, 0.0, 1.0],
    )


def rotated(u, v, angle):
    return u * np.cos(angle) - v * np.sin(angle), u * np.sin(angle) + v * np.cos(angle)


def eight_pointed_star(u, v, half):
    """Two squares of half side `half`, one turned by 45 degrees."""
    a, b = rotated(u, v, np.pi / 4)
    return np.minimum(np.maximum(np.abs(u), np.abs(v)), np.maximum(np.abs(a), np.abs(b))) - half


def rounded_square(u, v, half, radius):
    du, dv = np.abs(u) - half + radius, np.abs(v) - half + radius
    return np.hypot(np.maximum(du, 0), np.maximum(dv, 0)) + np.minimum(np.maximum(du, dv), 0) - radius


def frequencies(size):
    """Squared spatial frequency of each Fourier coefficient, in cycles per pixel."""
    return np.fft.fftfreq(size)[:, None] ** 2 + np.fft.rfftfreq(size)[None, :] ** 2


def noise(rng, size, scale):
    """Periodic Gaussian noise of unit variance with features of `scale` cm."""
    field = blurred(rng.standard_normal((size, size)), scale * size / PATCH_SIZE / 2)
    field -= field.mean()
    return np.clip(field / field.std(), -2.5, 2.5)


def blurred(image, sigma):
    """Periodic Gaussian blur, `sigma` in pixels."""
    size = image.shape[0]
    return np.fft.irfft2(np.fft.rfft2(image) * np.exp(-2 * np.pi**2 * sigma**2 * frequencies(size)), s=image.shape)


def averaged(image):
    """Box average over OVERSAMPLING x OVERSAMPLING pixels."""
    height, width, channels = image.shape
    n = OVERSAMPLING
    return image.reshape(height // n, n, width // n, n, channels).mean((1, 3))
