"""What is fitted: true maps and the photos made of them, and real captures."""

import json
import os
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
import tifffile
from PIL import Image

from shading import GAMMA, Maps, gamma22, render, unit

ROOT = Path(__file__).resolve().parents[2]
# The measuring data beside the repository.
SHARED = Path(os.environ.get("SVBRDF_GCN_SHARED", ROOT.parent / "shared"))

SIZE = 256
# Synthetic captures: a patch 2 wide, camera and light together at this height, up to this far from the centre.
PATCH_SIZE = 2.0
HEIGHT = 2.146
REACH = 1.2
# A white diffuse patch at the centre reads 1 with the light straight above.
INTENSITY = np.full(3, np.pi * HEIGHT**2)
PHOTOS = (1, 4, 8)
TESTS = 20
# One of the seeds whose photos and tests stand two thirds of the reach from the centre on average, as uniform ones do.
SEED = 17

CAPTURES = ("cards-blue", "wood-walnut", "leather-blue", "wall-plaster-white", "stone-spec-shiny", "giftbag1")
PHOTOS_IN, HELD_OUT = (0, 1, 2, 3, 4, 5, 6), (7, 8)


@dataclass(frozen=True)
class Shot:
    """One photo: where camera and light stood, how bright the light is, and the linear radiance (H, W, 3)."""

    camera: np.ndarray
    light: np.ndarray
    intensity: np.ndarray
    radiance: np.ndarray


def positions():
    """Camera positions of the photos (8, 3) and of the tests (20, 3), uniform on a disc.

    The first photo is from straight above, the next three each in a third of the disc, the last four each in a quarter, as a person walks around.
    """
    rng = np.random.default_rng(SEED)
    sectors = [2 * np.pi * (sector + rng.uniform()) / count for count in (3, 4) for sector in range(count)]
    angle = np.concatenate([sectors, rng.uniform(0, 2 * np.pi, TESTS)])
    radius = REACH * np.sqrt(rng.uniform(size=len(angle)))
    around = np.stack([radius * np.cos(angle), radius * np.sin(angle), np.full(len(angle), HEIGHT)], -1)
    photos = np.concatenate([[[0.0, 0.0, HEIGHT]], around[: len(sectors)]])
    return photos, around[len(sectors) :]


def picture(path):
    """An 8-bit picture as (H, W, C) in [0, 1], as stored."""
    with Image.open(path) as image:
        if image.mode not in ("L", "RGB"):
            raise ValueError(f"{path}: expected 8-bit grey or RGB, got mode {image.mode}")
        values = np.asarray(image, np.float64) / 255
    return values if values.ndim == 3 else values[..., None]


def box(values, size=SIZE):
    """Values (H, W, C) averaged over blocks to `size` rows and columns."""
    height, width, channels = values.shape
    if height % size or width % size:
        raise ValueError(f"size: expected a divisor of both sides, got {size} for {height} x {width}")
    return values.reshape(size, height // size, size, width // size, channels).mean((1, 3))


def colour(values):
    """Grey as RGB."""
    return np.repeat(values, 3, -1) if values.shape[-1] == 1 else values


@lru_cache(maxsize=2)
def linear_maps(name):
    """Maps of `shared/maps`: everything linear, normals (n + 1) / 2."""
    folder = SHARED / "maps" / name
    parts = {kind: picture(folder / f"{kind}.png") for kind in ("diffuse", "normal", "roughness", "specular")}
    return Maps(colour(parts["diffuse"]), unit(2 * parts["normal"] - 1), parts["roughness"][..., :1], colour(parts["specular"]))


def from_srgb(values):
    """sRGB-encoded values in linear light."""
    return np.where(values <= 0.04045, values / 12.92, ((values + 0.055) / 1.055) ** 2.4)


@lru_cache(maxsize=2)
def texture_maps(name):
    """Maps of `shared/textures`: base colour (sRGB), normal, roughness and, where there is one, metallic."""
    folder = SHARED / "textures" / name

    def read(kind):
        return picture(next(folder.glob(f"{kind}.*")))

    base, roughness = from_srgb(colour(read("basecolor"))), read("roughness")[..., :1]
    metallic = read("metallic")[..., :1] if any(folder.glob("metallic.*")) else np.zeros_like(roughness)
    specular = 0.04 * (1 - metallic) + base * metallic
    return Maps(box(base * (1 - metallic)), unit(box(unit(2 * read("normal") - 1))), box(roughness), box(specular))


def is_cc0(name):
    """Whether a texture is in the public domain by CC0, so that pictures of it may be shown."""
    rows = [line.split("\t") for line in (SHARED / "textures" / "MANIFEST.tsv").read_text().splitlines()]
    licence = rows[0].index("licence")
    return next(row[licence] for row in rows if row[0] == name).startswith("CC0")


def names(kind):
    """The names of a set: `maps`, `textures` or `real`."""
    if kind == "maps":
        return sorted(path.name for path in (SHARED / "maps").iterdir())
    if kind == "textures":
        return (ROOT / "python" / "svbrdf_gcn" / "training" / "validation.txt").read_text().split()
    return list(CAPTURES)


def truth(kind, name):
    """The true maps of a synthetic material."""
    return linear_maps(name) if kind == "maps" else texture_maps(name)


def write_capture(folder, maps):
    """Eight 8-bit photos in gamma 2.2 and their positions, in the layout of MaterialGAN (docs/captures.md)."""
    folder.mkdir(parents=True, exist_ok=True)
    cameras, _ = positions()
    for number, camera in enumerate(cameras):
        radiance = render(maps, camera, camera, INTENSITY, PATCH_SIZE)
        Image.fromarray(np.rint(gamma22(radiance) * 255).astype(np.uint8)).save(folder / f"{number:02}.png")
    lines = "".join(",".join(f"{value:.6f}" for value in camera) + "\n" for camera in cameras)
    (folder / "camera_pos.txt").write_text(lines)
    (folder / "light_pos.txt").write_text(lines)
    (folder / "image_size.txt").write_text(f"{PATCH_SIZE}\n")
    (folder / "light_power.txt").write_text(",".join(f"{value:.6f}" for value in INTENSITY) + "\n")


def synthetic_tests(maps):
    """The renderings under the test positions."""
    return [Shot(place, place, INTENSITY, render(maps, place, place, INTENSITY, PATCH_SIZE)) for place in positions()[1]]


def capture_folder(name):
    """The folder of a real capture."""
    return SHARED / "captures" / name


def real_tests(name):
    """The photos that are kept out of the fit, averaged in linear light."""
    folder = capture_folder(name)

    def numbers(file):
        return np.array([[float(v) for v in line.replace(",", " ").split()] for line in (folder / file).read_text().splitlines() if line.strip()])

    camera, light, power = numbers("camera_pos.txt"), numbers("light_pos.txt"), numbers("light_power.txt")[0]
    shots = []
    for view in HELD_OUT:
        (path,) = [found for found in folder.glob("*.png") if found.stem.isdigit() and int(found.stem) == view]
        shots.append(Shot(camera[view], light[view], power, box(colour(picture(path)) ** GAMMA)))
    return shots


def load_deviations(folder):
    """Standard deviations (H, W, 1) of the maps that `svbrdf-gcn fit --format tiff` wrote, by kind; None where it does not know them."""
    named = json.loads((folder / "material.json").read_text()).get("deviations")
    return named and {kind: tifffile.imread(folder / file).astype(np.float64)[..., None] for kind, file in named.items()}


def load_fit(folder):
    """Maps and patch size that `svbrdf-gcn fit --format tiff` wrote."""
    described = json.loads((folder / "material.json").read_text())
    parts = {}
    two = described["lobe"] == "anisotropic"
    for kind in ("diffuse", "normal", "roughness", "specular") + (("tangent",) if two else ()):
        entry = described["maps"][kind]
        if entry["transfer"] != "linear":
            raise ValueError(f"{folder}: expected linear maps, got {kind} in {entry['transfer']}")
        values = tifffile.imread(folder / entry["file"]).astype(np.float64)
        parts[kind] = values if values.ndim == 3 else values[..., None]
    normal = parts["normal"]
    tangent = unit(2 * parts["tangent"] - 1) if two else None
    roughness = parts["roughness"][..., : 2 if two else 1]
    return Maps(parts["diffuse"], unit(2 * normal - 1), roughness, parts["specular"], tangent), described["patch_size"]
