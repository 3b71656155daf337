#!/usr/bin/env python3
"""Scales the predicted standard deviations of a finished training: calibrate.py FOLDER

On every other held-out material (captures `near` and `real`, 1, 4 and 8 photos) the factor per map is found with which 68 % of the errors lie
within one standard deviation, and put into the certainty's last bias, in FOLDER/checkpoint's averaged weights. Run it once, after train.py
and before export.py; what it leaves is printed for the materials that it did not look at.
"""

import argparse
import json
import math
from pathlib import Path

import torch

import camera
import store
from library import open_pack
from losses import GROUPS, map_errors
from maps import decode_maps, encode_maps
from model import Model
from validate import capture, held_out

SHARE = 0.68


def ratios(model, maps, photos):
    """Errors over predicted standard deviations (M, 9, H, W), one for every family of captures and number of photos."""
    for family in ("near", "real"):
        for number in photos:
            shots = capture(maps, family, number)
            with torch.no_grad():
                raw, log_sigma = model(camera.network_input(shots.photos, shots.saturated, shots.stated))
            shown = encode_maps(decode_maps(raw, model.config["roughness_floor"]))
            yield map_errors(shown, encode_maps(shots.maps)) / torch.exp(log_sigma)


def main(arguments=None):
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    options = parser.parse_args(arguments)
    place = options.folder / "checkpoint"
    state = json.loads((place / "state.json").read_text())
    config = state["config"]
    if config.get("network") == "paper":
        raise SystemExit(f"{options.folder}: a network of the paper's form does not say how sure it is: there is nothing to calibrate")
    weights, _ = store.load(place / "average.safetensors")
    model = Model(config["model"]).eval()
    model.load_state_dict(weights)
    settings = config["validation"]
    maps = held_out(open_pack(config["data"]["pack"], validation=True)[1], settings["size"])
    seen = torch.cat(list(ratios(model, maps[::2], settings["photos"])))
    for name, group in GROUPS.items():
        values = seen[:, group].flatten()
        factor = float(values.kthvalue(math.ceil(SHARE * len(values))).values)
        with torch.no_grad():
            model.certainty.end.bias[group] += math.log(factor)
        print(f"{name}: standard deviations times {factor:.2f}")
    covered = torch.cat(list(ratios(model, maps[1::2], settings["photos"]))) < 1
    for name, group in GROUPS.items():
        print(f"{name}: {100 * covered[:, group].float().mean():.0f} % within one standard deviation on the other materials")
    weights["certainty.end.bias"] = model.certainty.end.bias.detach()
    store.save(place / "average.safetensors", weights)


if __name__ == "__main__":
    main()
