"""Makes photos as a telephone takes them of a printed sheet with glazed tiles in its window.

    .venv/bin/python python/tools/make_phone.py samples/phone --pdf sheet.pdf

Cycles path-traces the scene (`render_sheet.py`, in Blender's Python); the rest of a telephone is here: a lens that bends lines, light lost towards the edges of
the picture (cos^4) and off the flash's axis, noise, a tone curve, JPEG with halved colours (4:2:0), EXIF data that are 5 % wrong on the focal length, and one photo held upright.
`truth.json` says where everything was. With `--linear FOLDER` the same photos as a capture without any of that: linear, rectified with the positions that are true, under a light
that does not fall off. Needs what `make setup` installs.
"""

import argparse
import json
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
import OpenImageIO as oiio

sys.path.insert(0, str(Path(__file__).resolve().parent))

import make_photos  # noqa: E402
from make_photos import CENTER, WINDOW, Lens, Shot  # noqa: E402

HERE = Path(__file__).resolve().parent
PIXELS_PER_MM = 12.0
DEPTH = 1.0
LENS = Lens(0.755, (0.05, -0.07))
FOCAL_LENGTH_35MM = 26
# Of the flash: to the right and up of the lens in mm, its radius, its intensity, and the power of the cosine that its beam falls with.
LIGHT_OFFSET, LIGHT_RADIUS, BEAM = (14.0, 4.0), 1.5, 2.0
INTENSITY = (190000.0, 178000.0, 158000.0)
NOISE = 0.004
# More contrast than sRGB in the middle, and a shoulder; see make_photos.encode.
TONE = 0.035
JPEG_QUALITY = 92
# The pinhole picture reaches this far beyond the photo's, and is this much finer.
REACH, FINER = 1.12, 1.6
# Width of the patch in the window that `acquire` takes, and points along a side of a pixel of the capture with true positions.
PATCH, POINTS = 0.96 * WINDOW, 3


def shots(count):
    """One photo from above, the others from around; the third held upright."""
    size = (1500, 1000)
    made = [Shot((6.0, -4.0, 262.0), (2.0, 3.0, 0.0), 0.06, 1.0, size)]
    for i in range(count - 1):
        angle, lean = 2 * np.pi * i / (count - 1) + 0.7, np.radians(24 + 3 * np.cos(2 * i))
        far = 268 * (1 + 0.04 * np.sin(3 * i))
        place = far * np.array([np.cos(angle) * np.sin(lean), np.sin(angle) * np.sin(lean), np.cos(lean)])
        roll = 0.15 * np.sin(5 * i) + (np.pi / 2 if i == 1 else 0.0)
        made.append(Shot(tuple(place), (3 * np.sin(i), 2 * np.cos(2 * i), 0.0), roll, 1.0 if i % 2 else 0.85, size))
    return made


def developed(pinhole, shot, half_width, seed):
    """The photo of a pinhole picture under a light of intensity 1: codes of 8 bits."""
    width, height = shot.size
    out = np.zeros((height, width, 3))
    axes = make_photos.axes(shot)
    light = make_photos.light_position(make_photos.Scene(None, 0, LENS, light_offset=LIGHT_OFFSET), shot)
    samples = 2
    for k in range(samples * samples):
        dx, dy = (k % samples + 0.5) / samples, (k // samples + 0.5) / samples
        pixels = np.stack(np.meshgrid(np.arange(width) + dx, np.arange(height) + dy), -1).reshape(-1, 2)
        direction = LENS.directions(pixels, shot.size)
        scale = pinhole.shape[1] / (2 * half_width)
        value = looked_up(pinhole, direction, scale)
        rays = direction @ axes[:2] + axes[2]
        point = np.array(shot.camera) - rays * (shot.camera[2] / np.minimum(rays[:, 2], -1e-9))[:, None]
        to_light = light - point
        beam = np.clip((to_light @ -axes[2]) / np.linalg.norm(to_light, axis=-1), 0, 1) ** BEAM
        vignetting = 1 / (1 + (direction**2).sum(-1)) ** 2
        out += (value * (beam * vignetting)[:, None]).reshape(height, width, 3) / samples**2
    out = out * np.array(INTENSITY) * shot.exposure
    noise = np.random.default_rng(seed).standard_normal(out.shape)
    noisy = out + NOISE * np.sqrt(np.clip(out, 1e-4, None)) * noise
    return np.round(255 * make_photos.encode(np.clip(noisy, 0, 1), TONE)).astype(np.uint8)


def looked_up(pinhole, direction, scale):
    """A pinhole picture in directions (N, 2), `scale` pixels for a tangent of 1."""
    column = np.clip(direction[:, 0] * scale + pinhole.shape[1] / 2 - 0.5, 0, pinhole.shape[1] - 1.001)
    row = np.clip(direction[:, 1] * scale + pinhole.shape[0] / 2 - 0.5, 0, pinhole.shape[0] - 1.001)
    i, j = row.astype(int), column.astype(int)
    a, b = (row - i)[:, None], (column - j)[:, None]
    return (1 - a) * ((1 - b) * pinhole[i, j] + b * pinhole[i, j + 1]) + a * ((1 - b) * pinhole[i + 1, j] + b * pinhole[i + 1, j + 1])


def rectified(pinhole, shot, half_width, side):
    """The patch in a pinhole picture, (side, side, 3), linear."""
    axes, camera = make_photos.axes(shot), np.array(shot.camera)
    at = (np.arange(side * POINTS) + 0.5) / (side * POINTS) * PATCH - PATCH / 2
    x, y = np.meshgrid(at, -at)
    seen = (np.stack([x, y, np.full_like(x, -DEPTH)], -1).reshape(-1, 3) - camera) @ axes.T
    values = looked_up(pinhole, seen[:, :2] / seen[:, 2:], pinhole.shape[1] / (2 * half_width))
    return (values * np.array(INTENSITY) * shot.exposure).reshape(side, POINTS, side, POINTS, 3).mean((1, 3))


def write_linear(folder, pinholes, taken, lights, half_width, side):
    """A capture with the true positions; nothing of it is saturated."""
    folder.mkdir(parents=True, exist_ok=True)
    photos = []
    for i, (pinhole, shot, light) in enumerate(zip(pinholes, taken, lights)):
        buffer = oiio.ImageBuf(oiio.ImageSpec(side, side, 3, "float"))
        buffer.set_pixels(oiio.ROI(0, side, 0, side, 0, 1, 0, 3), rectified(np.load(pinhole), shot, half_width, side).astype(np.float32))
        if not buffer.write(str(folder / f"{i:02}.exr")):
            raise OSError(buffer.geterror())
        place = [[*point[:2], point[2] + DEPTH] for point in (list(map(float, shot.camera)), light)]
        photos.append({"file": f"{i:02}.exr", "camera": place[0], "light": place[1], "light_intensity": [value * shot.exposure for value in INTENSITY]})
    capture = {"format": "svbrdf-gcn capture", "version": 1, "unit": "mm", "patch_size": PATCH, "transfer": "linear", "photos": photos}
    (folder / "capture.json").write_text(json.dumps(capture, indent=1) + "\n")


def write_jpeg(path, pixels, upright=False, exposure=1.0, focal_length_35mm=FOCAL_LENGTH_35MM):
    height, width = pixels.shape[:2]
    spec = oiio.ImageSpec(width, height, 3, "uint8")
    spec.attribute("Compression", f"jpeg:{JPEG_QUALITY}")
    spec.attribute("jpeg:subsampling", "4:2:0")
    spec.attribute("Make", "svbrdf-gcn")
    spec.attribute("Model", "path-traced telephone")
    spec.attribute("Orientation", 6 if upright else 1)
    spec.attribute("ExposureTime", exposure / 60)
    spec.attribute("FNumber", 1.8)
    spec.attribute("Exif:Flash", 1)
    spec.attribute("Exif:FocalLengthIn35mmFilm", focal_length_35mm)
    spec.attribute("Exif:PixelXDimension", width)
    spec.attribute("Exif:PixelYDimension", height)
    buffer = oiio.ImageBuf(spec)
    buffer.set_pixels(oiio.ROI(0, width, 0, height, 0, 1, 0, 3), pixels)
    if not buffer.write(str(path)):
        raise OSError(buffer.geterror())


def main():
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("out", type=Path)
    parser.add_argument("--pdf", type=Path, required=True, help="what svbrdf-gcn sheet wrote")
    parser.add_argument("--count", type=int, default=5)
    parser.add_argument("--finer", type=float, default=FINER, help="pixels of what is path-traced along one of the photo")
    parser.add_argument("--linear", type=Path, help="folder for the same photos as a capture with true positions")
    parser.add_argument("--side", type=int, default=256, help="pixels along a side of that capture")
    parser.add_argument("--blender", default=str(HERE.parents[1] / ".venv" / "blender" / "bin" / "python"), help="a Python that has bpy")
    arguments = parser.parse_args()
    arguments.out.mkdir(parents=True, exist_ok=True)
    taken = shots(arguments.count)
    width, height = taken[0].size
    half_width = REACH * 0.5 / LENS.focal_length
    scene = make_photos.Scene(None, 0, LENS, light_offset=LIGHT_OFFSET)
    with tempfile.TemporaryDirectory() as folder:
        folder = Path(folder)
        page = make_photos.page(arguments.pdf, PIXELS_PER_MM)
        np.save(folder / "page.npy", page[..., None].astype(np.float32))
        fine = [int(side * arguments.finer * REACH) // 2 * 2 for side in (width, height)]
        job = {"page": str(folder / "page.npy"), "pixels_per_mm": PIXELS_PER_MM, "center": CENTER, "window": WINDOW, "depth": DEPTH, "light_radius": LIGHT_RADIUS}
        job["shots"] = [
            {
                "axes": make_photos.axes(shot).tolist(),
                "camera": list(map(float, shot.camera)),
                "light": make_photos.light_position(scene, shot).tolist(),
                "half_width": half_width,
                "size": fine,
                "out": str(folder / f"{i}.npy"),
            }
            for i, shot in enumerate(taken)
        ]
        (folder / "job.json").write_text(json.dumps(job))
        subprocess.run([arguments.blender, str(HERE / "render_sheet.py"), str(folder / "job.json")], check=True, stdout=subprocess.DEVNULL)
        for i, shot in enumerate(taken):
            pixels = developed(np.load(folder / f"{i}.npy"), shot, half_width, i)
            # Turned by a quarter, the photo is stored as the sensor sees it.
            write_jpeg(arguments.out / f"{i + 1}.jpg", pixels, i == 2, shot.exposure)
            print(f"{i + 1}.jpg: {(arguments.out / f'{i + 1}.jpg').stat().st_size} bytes, {100 * (pixels == 255).any(-1).mean():.1f} % of pixels at their top code")
        if arguments.linear:
            lights = [made["light"] for made in job["shots"]]
            write_linear(arguments.linear, [folder / f"{i}.npy" for i in range(len(taken))], taken, lights, half_width, arguments.side)
    photos = [
        {"file": f"{i + 1}.jpg", "camera": made["camera"], "light": made["light"], "exposure": shot.exposure}
        for i, (made, shot) in enumerate(zip(job["shots"], taken))
    ]
    # In the frame of the sheet, whose face is at z = 0; the capture's is the sample's, `depth` below.
    truth = {"depth": DEPTH, "light_offset": LIGHT_OFFSET, "light_intensity": INTENSITY, "focal_length": LENS.focal_length, "radial": LENS.radial, "tone": TONE}
    (arguments.out / "truth.json").write_text(json.dumps({**truth, "photos": photos}, indent=1) + "\n")


if __name__ == "__main__":
    main()
