"""Errors on held-out materials: the same crops, geometry and noise every time."""


import torch

import camera
from losses import GROUPS, map_errors
from maps import DIFFUSE, GAMMA, NORMAL, ROUGHNESS, SPECULAR, decode_maps, encode_maps
from render import encode_radiance, pixel_positions, render
from library import halved, sample_crops

SEED = 20_240_101


def held_out(bank, size):
    """Maps (M, 10, size, size) of whole materials, upright."""
    count, side = len(bank), bank.shape[-1]
    still = torch.zeros(count)
    levels = [bank, halved(bank)]
    return sample_crops(levels, torch.arange(count), size, still + side / size, still, torch.full((count, 2), 0.5), still + 1)


def capture(maps, family, photos, seed=SEED):
    """A capture of each material: `near` by a perfect camera above a level sample, `real` with every defect and tilt."""
    rng, noise_rng = torch.Generator().manual_seed(seed), torch.Generator(maps.device).manual_seed(seed + 1)
    height, width = maps.shape[-2:]
    geometry = camera.draw_geometry(rng, len(maps), photos, height, width, maps.device, family, whole=1.0, collocated=1.0)
    if family in ("near", "paper"):
        return camera.Capture(*camera.clean_photos(maps, geometry), geometry, maps)
    return camera.photograph(maps, geometry, rng, noise_rng)


def rmse(a, b):
    return float(((a - b) ** 2).mean((1, 2, 3)).sqrt().mean())


def scores(predicted, truth, raw, log_sigma, views):
    """Means over materials: RMSE of D, R, S linear and gamma 2.2, of (n + 1) / 2, mean normal angle, re-rendering RMSE, coverage."""
    out = {}
    for name, group in (("D", DIFFUSE), ("R", ROUGHNESS), ("S", SPECULAR)):
        a, b = predicted[:, group], truth[:, group]
        out[name], out[f"{name}_gamma"] = rmse(a, b), rmse(a ** (1 / GAMMA), b ** (1 / GAMMA))
    out["N"] = rmse(predicted[:, NORMAL] / 2, truth[:, NORMAL] / 2)
    cosine = (predicted[:, NORMAL] * truth[:, NORMAL]).sum(1).clamp(-1, 1)
    out["N_deg"] = float(torch.rad2deg(torch.acos(cosine)).mean())
    # The same positions for every material: above the patch, light and camera together.
    rng = torch.Generator().manual_seed(SEED + 7)
    geometry = camera.draw_geometry(rng, 1, views, 8, 8, truth.device, "near", whole=1.0, collocated=1.0)
    position = pixel_positions(*truth.shape[-2:], device=truth.device)[None]
    errors = []
    for a, b in zip(predicted, truth):
        pictures = render(torch.stack([a, b]), position, geometry.camera, geometry.light, geometry.intensity)
        a, b = encode_radiance(pictures).clamp(0, 1)
        errors.append(((a - b) ** 2).mean().sqrt())
    out["rendering"] = float(torch.stack(errors).mean())
    if log_sigma is not None:
        inside = (map_errors(raw, encode_maps(truth)) < torch.exp(log_sigma)).float()
        out.update({f"cover_{name}": float(inside[:, group].mean()) for name, group in GROUPS.items()})
    return {name: round(value, 5) for name, value in out.items()}


def validate(model, maps, settings, data, chunk=4):
    """Scores by family of captures and number of photos. `settings` are those of the validation, `data` those of the data."""
    model.eval()
    results = {}
    with torch.no_grad():
        for family in ("paper",) if data["captures"] == "paper" else ("near", "real"):
            for photos in settings["photos"]:
                shots = capture(maps, family, photos)
                inputs = camera.network_input(shots.photos, shots.saturated, shots.stated, data["directions"])
                outputs = [model(inputs[start : start + chunk]) for start in range(0, len(maps), chunk)]
                raw, log_sigma = (torch.cat(parts).float() if parts[0] is not None else None for parts in zip(*outputs))
                floor = model.config["roughness_floor"]
                predicted = decode_maps(raw, floor)
                shown = encode_maps(predicted)
                results[f"{family} {photos}"] = scores(predicted, shots.maps, shown, log_sigma, settings["views"])
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
