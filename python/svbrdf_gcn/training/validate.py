"""Errors on held-out materials: the same captures every time."""

import torch

from .data import tensors
from .losses import GROUPS, map_errors
from .maps import DIFFUSE, GAMMA, NORMAL, ROUGHNESS, SPECULAR, decode_maps, encode_maps
from .render import encode_radiance, pixel_positions, render


def captures(data, family, photos, settings, device, numbers=None, chunk=4):
    """Batches of at most `chunk` captures of the materials held out, all or those of these `numbers`; `family` as for `TrainingData.validation`."""
    if numbers is not None:
        for number in numbers:
            yield tensors(data.validation(family, photos, settings["size"], number, 1, settings["views"]), device)
        return
    for first in range(0, len(data.held_out), chunk):
        count = min(chunk, len(data.held_out) - first)
        yield tensors(data.validation(family, photos, settings["size"], first, count, settings["views"]), device)


def rmse(a, b):
    return ((a - b) ** 2).mean((1, 2, 3)).sqrt()


def scores(predicted, truth, raw, log_sigma, views):
    """By material, (B,): RMSE of D, R, S linear and gamma 2.2, of (n + 1) / 2, mean normal angle, re-rendering RMSE, coverage."""
    out = {}
    for name, group in (("D", DIFFUSE), ("R", ROUGHNESS), ("S", SPECULAR)):
        a, b = predicted[:, group], truth[:, group]
        out[name], out[f"{name}_gamma"] = rmse(a, b), rmse(a ** (1 / GAMMA), b ** (1 / GAMMA))
    out["N"] = rmse(predicted[:, NORMAL] / 2, truth[:, NORMAL] / 2)
    cosine = (predicted[:, NORMAL] * truth[:, NORMAL]).sum(1).clamp(-1, 1)
    out["N_deg"] = torch.rad2deg(torch.acos(cosine)).mean((1, 2))
    position = pixel_positions(*truth.shape[-2:], device=truth.device)[None]
    errors = []
    for a, b, shots in zip(predicted, truth, views):
        camera, light, intensity = shots[None].unbind(2)
        a, b = encode_radiance(render(torch.stack([a, b]), position, camera, light, intensity)).clamp(0, 1)
        errors.append(((a - b) ** 2).mean().sqrt())
    out["rendering"] = torch.stack(errors)
    if log_sigma is not None:
        inside = (map_errors(raw, encode_maps(truth)) < torch.exp(log_sigma)).float()
        out.update({f"cover_{name}": inside[:, group].mean((1, 2, 3)) for name, group in GROUPS.items()})
    return out


def validate(model, data, config, device):
    """Scores by family of captures and number of photos: `near` by a perfect camera above a level sample, `real` with every defect and tilt; `paper`."""
    settings, floor = config["validation"], model.config["roughness_floor"]
    model.eval()
    results = {}
    with torch.no_grad():
        for family in ("paper",) if config["data"]["captures"] == "paper" else ("near", "real"):
            for photos in settings["photos"]:
                rows = []
                for batch in captures(data, family, photos, settings, device):
                    raw, log_sigma = model(batch["inputs"])
                    predicted = decode_maps(raw.float(), floor)
                    log_sigma = None if log_sigma is None else log_sigma.float()
                    rows.append(scores(predicted, batch["maps"], encode_maps(predicted), log_sigma, batch["views"]))
                results[f"{family} {photos}"] = {name: round(float(torch.cat([row[name] for row in rows]).mean()), 5) for name in rows[0]}
    model.train()
    return results


def summary(results):
    """One line per row, for people."""
    lines = []
    for name, row in results.items():
        cover = "/".join(f"{row[f'cover_{group}']:.2f}" for group in GROUPS if f"cover_{group}" in row)
        errors = " ".join(f"{key} {row[key]:.3f}" for key in ("D", "N", "R", "S", "rendering"))
        lines.append(f"  {name:7} {errors}  {row['N_deg']:.1f} deg" + (f"  within sigma {cover}" if cover else ""))
    return "\n".join(lines)
