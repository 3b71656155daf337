"""How far maps and pictures are from the truth."""

import flip_evaluator
import numpy as np

import lpips_alex
from shading import gamma22, render

MAPS = {"D": "diffuse", "N": "normal", "R": "roughness", "S": "specular"}


def rmse(a, b):
    """Root mean square of the difference over all pixels and channels."""
    return float(np.sqrt(np.mean((a - b) ** 2)))


def angle_deg(a, b):
    """Mean angle between unit vectors, in degrees."""
    # The arc tangent: an arc cosine loses small angles.
    return float(np.degrees(np.arctan2(np.linalg.norm(np.cross(a, b), axis=-1), (a * b).sum(-1))).mean())


def map_errors(maps, truth):
    """RMSE of D, R, S linear and in gamma 2.2, of N as (n + 1) / 2, and the mean angle of normals in degrees."""
    errors = {"angle": angle_deg(maps.normal, truth.normal), "N": rmse(maps.normal / 2, truth.normal / 2)}
    for letter in "DRS":
        ours, true = getattr(maps, MAPS[letter]), getattr(truth, MAPS[letter])
        if letter == "R" and ours.shape != true.shape:
            # Two roughnesses are compared where both have two.
            ours, true = maps.mean_roughness, truth.mean_roughness
        errors[letter] = rmse(ours, true)
        errors[f"{letter}22"] = rmse(gamma22(ours), gamma22(true))
    return errors


def covered(maps, deviations, truth):
    """The share of pixels whose error, for colours its root mean square, is within one standard deviation, by letter of the map."""
    out = {}
    for letter, kind in MAPS.items():
        off = maps.mean_roughness - truth.mean_roughness if letter == "R" else getattr(maps, kind) - getattr(truth, kind)
        error = np.hypot(off[..., :1], off[..., 1:2]) if letter == "N" else np.sqrt((off**2).mean(-1, keepdims=True))
        out[letter] = float((error <= deviations[kind]).mean())
    return out


def flip(picture, reference):
    """Mean FLIP (LDR, 67 pixels a degree) of linear pictures in [0, 1]."""
    clamped = [np.clip(x, 0, 1).astype(np.float32) for x in (reference, picture)]
    return float(flip_evaluator.evaluate(*clamped, "LDR", inputsRGB=False, applyMagma=False)[1])


class Views:
    """True pictures under known positions, to hold renderings of maps against."""

    def __init__(self, shots):
        self.shots = shots
        self.features = None

    def errors(self, maps, patch_size):
        """Means over the pictures: `ren` (RMSE in gamma 2.2, clamped), `lpips`, `flip`; and `each`, the RMSE of every one."""
        if self.features is None:
            self.features = [lpips_alex.features(gamma22(shot.radiance)) for shot in self.shots]
        each, lpips, flips = [], [], []
        for shot, features in zip(self.shots, self.features, strict=True):
            radiance = render(maps, shot.camera, shot.light, shot.intensity, patch_size)
            each.append(rmse(gamma22(radiance), gamma22(shot.radiance)))
            lpips.append(lpips_alex.distance(lpips_alex.features(gamma22(radiance)), features))
            flips.append(flip(radiance, shot.radiance))
        return {"ren": float(np.mean(each)), "lpips": float(np.mean(lpips)), "flip": float(np.mean(flips)), "each": each}
