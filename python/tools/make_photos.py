"""Raw photos of a printed sheet, made without this project's renderer: rays through a lens with distortion, numpy, nothing else.

The sheet is the PDF that `svbrdf-gcn sheet` writes, rasterised by PDFium; in its window lies a matt pattern. Light falls off with the square of
the distance, with the cosine at the surface, towards the edges of the picture (cos^4) and off the axis of the flash. There may be other light in the
room, and the camera may bend its tone curve.
"""

import argparse
import json
import sys
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent))

import png  # noqa: E402

# Where the middle of the window is on an A4 sheet with a window of 100 mm, in mm from the upper left.
CENTER = (105.0, 92.0)
WINDOW = 100.0
# Diffuse albedo of toner and of paper.
BLACK, WHITE = 0.04, 0.8


@dataclass
class Lens:
    """A pinhole with two radial terms; lengths in longer sides of the picture."""

    focal_length: float = 0.78
    radial: tuple = (0.06, -0.09)

    def directions(self, pixels, size):
        """x / z and y / z of pixels (N, 2), y down."""
        seen = (pixels - np.array(size) / 2) / (self.focal_length * max(size))
        return seen * self._shrunk(np.einsum("ij,ij->i", seen, seen))[:, None]

    def pixels(self, directions, size):
        """The inverse: where x / z and y / z, (N, 2), are in the picture."""
        r2 = (directions**2).sum(-1, keepdims=True)
        return directions * (1 + r2 * (self.radial[0] + r2 * self.radial[1])) * self.focal_length * max(size) + np.array(size) / 2

    def _shrunk(self, seen2):
        """What the distance from the middle is multiplied by where distortion is taken out, from its square."""
        return np.interp(seen2, *_table(self.radial, float(np.ceil(np.sqrt(seen2.max())))))


@lru_cache
def _table(radial, reach):
    """Squares of distances from the middle, and what those are multiplied by where distortion is taken out."""
    seen = np.linspace(0, reach, 20000)
    found = seen.copy()
    for _ in range(30):
        found = seen / (1 + found**2 * (radial[0] + found**2 * radial[1]))
    return seen**2, np.divide(found, seen, out=np.ones_like(seen), where=seen > 0)


@dataclass
class Shot:
    """Where the camera stood (mm), what it looked at, how it was turned, and how bright its flash was."""

    camera: tuple
    target: tuple = (0.0, 0.0, 0.0)
    roll: float = 0.0
    exposure: float = 1.0
    size: tuple = (1500, 1000)
    blur: int = 0
    flash: bool = True


@dataclass
class Scene:
    page: np.ndarray
    pixels_per_mm: float
    lens: Lens
    intensity: tuple = (150000.0, 140000.0, 120000.0)
    light_offset: tuple = (0.0, 0.0)
    beam: float = 2.0
    vignetting: bool = True
    noise: float = 0.004
    depth: float = 0.0
    # Light of the room: irradiance in photo units, the same everywhere. Tone curve: what is taken from sRGB's code u, times sin(2 pi u).
    room: tuple = (0.0, 0.0, 0.0)
    tone: float = 0.0


def page(pdf, pixels_per_mm=12.0, finer=4):
    """The sheet as diffuse albedo, (H, W). PDFium widens what it fills to whole pixels: those are `finer` times as fine."""
    import pypdfium2

    document = pypdfium2.PdfDocument(str(pdf))
    picture = document[0].render(scale=finer * pixels_per_mm * 25.4 / 72, grayscale=True).to_numpy()
    height, width = picture.shape[0] // finer, picture.shape[1] // finer
    blocks = picture.reshape(picture.shape[:2])[: height * finer, : width * finer].reshape(height, finer, width, finer)
    return BLACK + (WHITE - BLACK) * blocks.mean((1, 3), dtype=np.float32) / 255


def pattern(x, y):
    """Diffuse albedo in the window, (..., 3), from positions in mm: waves of many lengths, and a checkerboard."""
    waves = 0.12 * np.sin(x / 2.1 + 0.3 * y) + 0.1 * np.cos(y / 3.3 - 0.2 * x) + 0.1 * np.sin((x + y) / 9)
    board = 0.12 * (((np.floor(x / 8) + np.floor(y / 8)) % 2) - 0.5)
    base = 0.35 + waves + board
    return np.clip(np.stack([base, 0.8 * base + 0.05, 0.5 * base + 0.1 * np.sin(x / 15)], -1), 0.01, 0.95)


def paper(scene, x, y):
    """Diffuse albedo of the page, or of what it lies on, at positions in mm."""
    column = (x + CENTER[0]) * scene.pixels_per_mm - 0.5
    row = (CENTER[1] - y) * scene.pixels_per_mm - 0.5
    height, width = scene.page.shape
    c, r = np.clip(column.astype(int), 0, width - 2), np.clip(row.astype(int), 0, height - 2)
    fc, fr = np.clip(column - c, 0, 1), np.clip(row - r, 0, 1)
    p = scene.page
    found = (1 - fr) * ((1 - fc) * p[r, c] + fc * p[r, c + 1]) + fr * ((1 - fc) * p[r + 1, c] + fc * p[r + 1, c + 1])
    on_page = (column > 0) & (row > 0) & (column < width - 1) & (row < height - 1)
    return np.where(on_page, found, 0.25)


def axes(shot):
    """Right, down and forward of the camera."""
    camera = np.array(shot.camera, float)
    forward = np.array(shot.target, float) - camera
    forward /= np.linalg.norm(forward)
    right = np.cross(forward, [0.0, 1.0, 1e-3])
    right /= np.linalg.norm(right)
    down = np.cross(forward, right)
    cos, sin = np.cos(shot.roll), np.sin(shot.roll)
    return np.stack([cos * right + sin * down, cos * down - sin * right, forward])


def light_position(scene, shot):
    right, down, _ = axes(shot)
    return np.array(shot.camera) + scene.light_offset[0] * right - scene.light_offset[1] * down


def photograph(scene, shot, seed=0, samples=3):
    """An 8-bit sRGB photo, (H, W, 3)."""
    width, height = shot.size
    out = np.empty((height, width, 3))
    # Few rows at a time stay in the processor's cache.
    for top in range(0, height, 32):
        bottom = min(height, top + 32)
        offsets = [((k % samples + 0.5) / samples, (k // samples + 0.5) / samples) for k in range(samples**2)]
        out[top:bottom] = sum(_radiance(scene, shot, top, bottom, *offset) for offset in offsets) / samples**2
    for _ in range(shot.blur):
        out = (out + np.roll(out, 1, 1) + np.roll(out, -1, 1)) / 3
    noise = np.random.default_rng(seed).standard_normal(out.shape, np.float32)
    out = np.clip(out + scene.noise * np.sqrt(np.clip(out, 1e-4, None)) * noise, 0, 1)
    return np.round(255 * encode(out, scene.tone)).astype(np.uint8)


def _radiance(scene, shot, top, bottom, dx, dy):
    """Radiance in rows of a photo, (rows, W, 3), at points within its pixels."""
    camera, frame, light = np.array(shot.camera, float), axes(shot), light_position(scene, shot)
    width = shot.size[0]
    pixels = np.stack(np.meshgrid(np.arange(width) + dx, np.arange(top, bottom) + dy), -1).reshape(-1, 2)
    u, v = scene.lens.directions(pixels, shot.size).T
    ray = [u * frame[0, i] + v * frame[1, i] + frame[2, i] for i in range(3)]
    down = np.minimum(ray[2], -1e-9)

    def hit(z):
        far = (z - camera[2]) / down
        return [camera[0] + far * ray[0], camera[1] + far * ray[1], np.full_like(far, z)]

    point = hit(0.0)
    color = np.repeat(paper(scene, point[0], point[1])[:, None], 3, 1)
    inside = np.flatnonzero((np.abs(point[0]) < WINDOW / 2) & (np.abs(point[1]) < WINDOW / 2))
    below = hit(-scene.depth)
    for axis in range(3):
        point[axis][inside] = below[axis][inside]
    color[inside] = pattern(point[0][inside], point[1][inside])
    to_light = [light[i] - point[i] for i in range(3)]
    d2 = to_light[0] ** 2 + to_light[1] ** 2 + to_light[2] ** 2
    cosine = -(to_light[0] * frame[2, 0] + to_light[1] * frame[2, 1] + to_light[2] * frame[2, 2]) / np.sqrt(d2)
    irradiance = np.clip(to_light[2], 0, None) / d2**1.5 * np.clip(cosine, 0, 1) ** scene.beam
    vignetting = 1 / (1 + u**2 + v**2) ** 2 if scene.vignetting else np.ones_like(u)
    seen = color * (np.array(scene.intensity) * shot.flash * irradiance[:, None] + np.array(scene.room)) * (vignetting * shot.exposure / np.pi)[:, None]
    return seen.reshape(bottom - top, width, 3)


def encode(linear, tone):
    """Codes of linear values from 0 to 1."""
    code = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
    return code - tone * np.sin(2 * np.pi * code)


def around(count=9, distance=250.0, lean=25.0, size=(1500, 1000)):
    """One photo from above, the others from around, turned a little."""
    shots = [Shot((4.0, -3.0, distance), (1.0, 2.0, 0.0), 0.05, size=size)]
    for i in range(count - 1):
        angle = 2 * np.pi * i / (count - 1) + 0.3
        far, tilt = distance * (1 + 0.06 * np.sin(3 * i)), np.radians(lean + 4 * np.cos(2 * i))
        place = far * np.array([np.cos(angle) * np.sin(tilt), np.sin(angle) * np.sin(tilt), np.cos(tilt)])
        exposure = 1.0 if i % 3 else 0.8
        shots.append(Shot(tuple(place), (3 * np.sin(i), 3 * np.cos(2 * i), 0.0), 0.2 * np.sin(5 * i), exposure, size))
    return shots


def shifts(rectified, expected, block=64):
    """How far the corners of a rectified photo are from where they should be, in pixels: least squares on the differences, in the logarithm."""
    found = []
    a, b = np.log(np.clip(rectified, 1e-4, None)).mean(-1), np.log(expected).mean(-1)
    for rows in (slice(0, block), slice(-block, None)):
        for columns in (slice(0, block), slice(-block, None)):
            p, q = a[rows, columns], b[rows, columns]
            gy, gx = np.gradient(q)
            terms = np.stack([gx, gy, np.ones_like(gx), *np.meshgrid(np.arange(block), np.arange(block))], -1).reshape(-1, 5)
            inner = np.zeros_like(q, bool)
            inner[2:-2, 2:-2] = True
            solution = np.linalg.lstsq(terms[inner.ravel()], (p - q).ravel()[inner.ravel()], rcond=None)[0]
            found.append(float(np.hypot(*solution[:2])))
    return found


def fall_off_error(lens, scene, shot):
    """RMS error of what `acquire` took for the fall-offs of lens and flash in a photo of the sheet, up to a factor."""
    at = np.linspace(-77, 77, 24)
    x, y = np.meshgrid(at, at)
    u, v, z = (axes(shot) @ (np.stack([x.ravel(), y.ravel(), 0 * x.ravel()]) - np.array(shot.camera)[:, None]))
    r2 = (u**2 + v**2) / z**2

    def flash2(offset):
        return ((u - offset[0]) ** 2 + (v + offset[1]) ** 2) / z**2

    true = -2 * np.log1p(r2) * scene.vignetting - scene.beam / 2 * np.log1p(flash2(scene.light_offset))
    s2 = flash2(lens["light_offset"])
    (a, b), (c, e) = lens["fall_off"], lens["flash_fall_off"]
    off = a * r2 + b * r2**2 + c * s2 + e * s2**2 - true
    return float(off.std())


def compare(capture, report, scenes, shots):
    """Errors of a `svbrdf_gcn.Capture` of photos 0.png, 1.png, ..., each of its scene: dictionaries of lists."""
    used = [int(Path(photo["photo"]).stem) for photo in report["photos"]]
    errors = {"position": [], "corner": [], "light": [], "albedo": [], "fall_off": []}
    side, patch = capture.height, capture.patch_size
    at = (np.arange(side) + 0.5) / side * patch - patch / 2
    # As rectified photos are: the mean over each pixel's square. Points alone moved the corners by up to a fifth of a pixel.
    fine = (np.arange(4 * side) + 0.5) / (4 * side) * patch - patch / 2
    truth = pattern(*np.meshgrid(fine, -fine)).reshape(side, 4, side, 4, -1).mean((1, 3))
    gains = []
    for i, index in enumerate(used):
        scene, shot = scenes[index], shots[index]
        place = np.array(shot.camera) + [0, 0, scene.depth]
        errors["position"].append(float(np.linalg.norm(capture.camera_positions[i] - place) / np.linalg.norm(place)))
        gains.append(np.array(capture.light_intensity[i]) / (np.array(scene.intensity) * shot.exposure))
        x, y = np.meshgrid(at, -at)
        to_light = np.array(capture.light_positions[i]) - np.stack([x, y, 0 * x], -1)
        irradiance = to_light[..., 2] / np.linalg.norm(to_light, axis=-1) ** 3
        found = capture.photos[i] * np.pi / (irradiance[..., None] * np.array(capture.light_intensity[i]))
        errors["corner"].extend(shifts(found, truth))
        errors["fall_off"].append(fall_off_error(report["lenses"][report["photos"][i]["lens"]], scene, shot))
        errors["albedo"].append(float(np.sqrt(np.mean((found / truth - 1) ** 2))))
    gains = np.array(gains)
    errors["light"] = np.abs(gains / np.median(gains, 0) - 1).max(-1).tolist()
    return errors


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("out", type=Path)
    parser.add_argument("--pdf", type=Path, required=True, help="what svbrdf-gcn sheet wrote")
    parser.add_argument("--count", type=int, default=9)
    parser.add_argument("--size", type=int, nargs=2, default=(1500, 1000))
    arguments = parser.parse_args()
    arguments.out.mkdir(parents=True, exist_ok=True)
    scene = Scene(page(arguments.pdf), 12.0, Lens())
    shots = around(arguments.count, size=tuple(arguments.size))
    for i, shot in enumerate(shots):
        png.write(arguments.out / f"{i}.png", photograph(scene, shot, i))
    (arguments.out / "truth.json").write_text(json.dumps([{"camera": list(map(float, shot.camera)), "exposure": shot.exposure} for shot in shots]))


if __name__ == "__main__":
    main()
