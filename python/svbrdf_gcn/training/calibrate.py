"""Calibration of the certainty: by what factors predicted standard deviations are off.

On every other held-out material (captures `near` and `real`, all numbers of photos of the validation) the factor per map is found with which 68 % of the errors
lie within one standard deviation, and put into the certainty's last bias. `export.py` does so, on a copy: the checkpoint stays as it was trained.
"""

import math

import torch

from .losses import GROUPS, map_errors
from .maps import decode_maps, encode_maps
from .validate import captures

SHARE = 0.68


def ratios(model, data, settings, device, numbers):
    """Errors over predicted standard deviations, (B, 9, H, W) for every capture of the materials `numbers`."""
    for family in ("near", "real"):
        for photos in settings["photos"]:
            for batch in captures(data, family, photos, settings, device, numbers):
                with torch.no_grad():
                    raw, log_sigma = model(batch["inputs"])
                shown = encode_maps(decode_maps(raw, model.config["roughness_floor"]))
                yield (map_errors(shown, encode_maps(batch["maps"])) / torch.exp(log_sigma)).cpu()


def calibrate(model, data, settings, device):
    """Scale the standard deviations that `model` predicts; returns the factor of every map, and the share covered on the materials that were not looked at."""
    numbers = range(len(data.held_out))
    seen = torch.cat(list(ratios(model, data, settings, device, numbers[::2])))
    factors = {}
    for name, group in GROUPS.items():
        values = seen[:, group].flatten()
        factors[name] = float(values.kthvalue(math.ceil(SHARE * len(values))).values)
        with torch.no_grad():
            model.certainty.end.bias[group] += math.log(factors[name])
    if len(numbers) < 2:
        return factors, {}
    inside = torch.cat(list(ratios(model, data, settings, device, numbers[1::2]))) < 1
    return factors, {name: float(inside[:, group].float().mean()) for name, group in GROUPS.items()}
