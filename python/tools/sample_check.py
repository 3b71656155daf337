"""Compares a sample capture with the shading model of the project, computed from the true maps. Needs numpy only.

    python3 python/tools/sample_check.py samples/tiles [--sheet docs/images/sample-tiles.jpg]

prints for each photo: the error of the re-rendering (RMSE in gamma 2.2, both clamped to [0, 1]), the mean of photo / re-rendering
over the pixels that are neither saturated nor black, and the displacement between the two in pixels. `--sheet` draws photos and maps
in one picture (needs Pillow).
"""

import argparse
import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np

import png


@dataclass
class Sample:
    """A capture as the script wrote it: linear photos and the true maps, (H, W, C) float64, row 0 at the top."""

    capture: dict
    photos: list
    saturated: list
    truth: dict


def load(folder):
    """Read `capture.json`, the photos and `truth/`; photos are decoded, `normal` is unit length."""
    folder = Path(folder)
    capture = json.loads((folder / "capture.json").read_text())
    stored = [png.read(folder / photo["file"]) for photo in capture["photos"]]
    maps = json.loads((folder / "truth" / "material.json").read_text())["maps"]
    truth = {name: unit_range(png.read(folder / "truth" / one["file"])) for name, one in maps.items()}
    for name in {"normal", "tangent"} & truth.keys():
        truth[name] = unit(2 * truth[name] - 1)
    return Sample(
        capture=capture,
        photos=[decode(unit_range(photo), capture["transfer"]) for photo in stored],
        saturated=[photo == np.iinfo(photo.dtype).max for photo in stored],
        truth=truth,
    )


def unit_range(stored):
    return stored / np.iinfo(stored.dtype).max


def unit(vectors):
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


def decode(stored, transfer):
    """Linear values of stored ones, `srgb` or `linear`."""
    if transfer == "linear":
        return stored
    return np.where(stored <= 0.04045, stored / 12.92, ((stored + 0.055) / 1.055) ** 2.4)


def shade(truth, camera, light, light_intensity, patch_size):
    """Radiance of every pixel, (H, W, 3): Lambert and GGX lobe, round or stretched, with the project's masking and Fresnel forms."""
    normal, roughness, specular = truth["normal"], truth["roughness"], truth["specular"]
    height, width, _ = normal.shape
    x = ((np.arange(width) + 0.5) / width - 0.5) * patch_size
    y = -((np.arange(height) + 0.5) / height - 0.5) * patch_size * height / width
    points = np.stack([*np.meshgrid(x, y), np.zeros((height, width))], -1)

    def dot(a, b):
        return (a * b).sum(-1, keepdims=True)

    to_light = np.asarray(light) - points
    view_dir, light_dir = unit(np.asarray(camera) - points), unit(to_light)
    half_vector = unit(view_dir + light_dir)
    n_dot_l, n_dot_v, v_dot_h = dot(normal, light_dir), dot(normal, view_dir), dot(view_dir, half_vector)
    alpha = np.maximum(roughness, 1e-3) ** 2
    if "tangent" in truth:
        along, wide = alpha[..., :1], alpha[..., 1:2]
        tangent = unit(truth["tangent"] - normal * dot(normal, truth["tangent"]))
        bitangent = np.cross(normal, tangent)

        def stretched(vectors):
            return (along * dot(tangent, vectors)) ** 2 + (wide * dot(bitangent, vectors)) ** 2

        lean = (dot(tangent, half_vector) / along) ** 2 + (dot(bitangent, half_vector) / wide) ** 2
        ndf = 1 / (np.pi * along * wide * (lean + dot(normal, half_vector) ** 2) ** 2)
        visibility = 1 / ((n_dot_l + np.sqrt(stretched(light_dir) + n_dot_l**2)) * (n_dot_v + np.sqrt(stretched(view_dir) + n_dot_v**2)))
    else:
        across = np.cross(normal, half_vector)
        ndf = alpha**2 / (np.pi * (dot(across, across) + dot(normal, half_vector) ** 2 * alpha**2) ** 2)
        k = alpha / 2
        visibility = 1 / (4 * (n_dot_l * (1 - k) + k) * (n_dot_v * (1 - k) + k))
    fresnel = specular + (1 - specular) * 2 ** ((-5.55473 * v_dot_h - 6.98316) * v_dot_h)
    brdf = truth["diffuse"] * (1 - specular) / np.pi + ndf * visibility * fresnel
    lit = (n_dot_l > 0) & (n_dot_v > 0)
    return np.where(lit, brdf * n_dot_l * np.asarray(light_intensity) / dot(to_light, to_light), 0)


def rendering(sample, index):
    """The re-rendering of photo `index` from the true maps, not clamped."""
    capture, photo = sample.capture, sample.capture["photos"][index]
    intensity = photo.get("light_intensity", capture["light_intensity"])
    return shade(sample.truth, photo["camera"], photo["light"], intensity, capture["patch_size"])


def gamma(linear):
    return np.clip(linear, 0, 1) ** (1 / 2.2)


def rmse(a, b):
    return float(np.sqrt(np.mean((a - b) ** 2)))


def displacement(image, reference):
    """(dx, dy) in pixels by which `image` (H, W) lies right of and below `reference`: least squares on its gradient."""
    gradient_y, gradient_x = np.gradient(reference)
    inner = (slice(2, -2), slice(2, -2))
    slopes = np.stack([gradient_x[inner].ravel(), gradient_y[inner].ravel()], 1)
    difference = (image - reference)[inner].ravel()
    return -np.linalg.lstsq(slopes, difference - difference.mean(), rcond=None)[0]


def report(sample, index):
    """(RMSE, mean photo / re-rendering, (dx, dy)) of one photo against its re-rendering."""
    photo, model = sample.photos[index], rendering(sample, index)
    clear = ~sample.saturated[index] & (photo > 0.01)
    shift = displacement(gamma(photo).mean(-1), gamma(model).mean(-1))
    return rmse(gamma(photo), gamma(model)), float((photo[clear] / model[clear]).mean()), shift


def sheet(sample):
    """Photo 0, photos 1 to 8 at half size, the re-rendering of photo 0; below, the true maps. (512, 1024, 3), [0, 1], 256 x 256 sample."""

    def framed(picture):
        picture = picture.copy()
        picture[:2] = picture[-2:] = 1
        picture[:, :2] = picture[:, -2:] = 1
        return picture

    photos = [gamma(photo) for photo in sample.photos]
    halved = [framed(photo.reshape(128, 2, 128, 2, 3).mean((1, 3))) for photo in photos[1:9]]
    small = np.concatenate([np.concatenate(halved[:4], 1), np.concatenate(halved[4:], 1)], 0)
    top = np.concatenate([framed(photos[0]), small, framed(gamma(rendering(sample, 0)))], 1)
    truth = sample.truth
    roughness = truth["roughness"].repeat(3, 2)
    maps = [gamma(truth["diffuse"]), gamma(truth["specular"]), roughness, (truth["normal"] + 1) / 2]
    return np.concatenate([top, np.concatenate([framed(picture) for picture in maps], 1)], 0)


def main():
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("folder", type=Path, help="folder with capture.json and truth/")
    parser.add_argument("--sheet", type=Path, help="picture to write: photos above, maps below")
    options = parser.parse_args()
    sample = load(options.folder)
    errors = []
    for index, saturated in enumerate(sample.saturated):
        error, ratio, (dx, dy) = report(sample, index)
        errors.append(error)
        share = 100 * saturated.any(-1).mean()
        print(f"photo {index}: RMSE {error:.4f}, photo/model {ratio:.4f}, displaced {dx:+.3f} {dy:+.3f} px, saturated {share:.2f} %")
    print(f"mean RMSE {np.mean(errors):.4f}")
    if options.sheet:
        from PIL import Image

        pixels = np.round(sheet(sample) * 255).astype(np.uint8)
        Image.fromarray(pixels).save(options.sheet, quality=88)


if __name__ == "__main__":
    main()
