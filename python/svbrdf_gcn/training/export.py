"""Writes the averaged weights of a training as one safetensors file: python -m svbrdf_gcn.training.export FOLDER -o weights.safetensors [--f32]

The certainty is calibrated on half of the materials held out (calibrate.py); the checkpoint stays as it is. Tensors are named as in model.py. The metadata state what a reader must know: the architecture as JSON, the conventions of maps and photos, the
licence, what the weights were trained on, and the last validation.
"""

import argparse
import json
from pathlib import Path

import torch

from ..errors import SvbrdfError
from . import checksums, configuration, paper, store
from .calibrate import calibrate
from .data import open_data
from .model import ADAPTERS, HINT_RIDGE, LOG_SIGMA, NORM_EPS, RATIO_MAX, SPREAD_EPS

# The conventions of docs/weights.md.
CONVENTIONS = {
    "format": "svbrdf-gcn weights",
    "version": checksums.VERSION,
    "brdf": "paper",
    "roughness": "perceptual",
    "color_space": "photos gamma2.2, albedos gamma2.2 of [-1, 1]",
    "channels": "diffuse 3, normal 2, roughness 1, specular 3",
}
INPUTS = "photo gamma2.2 3, ratio to white diffuse gamma2.2 3, saturated 1, light direction 3, half vector 3"
HINT_PLANES = "slope of ratio in half vector xy 2, highlight in half vector xy 2, least ratio 3, mean ratio 3"


def architecture(config):
    """What a reader needs to build the network, as a dictionary."""
    return {
        "kind": "photo graph",
        **config,
        "inputs": INPUTS,
        "hints": HINT_PLANES,
        "hint_ridge": HINT_RIDGE,
        "ratio_max": RATIO_MAX,
        "norm_eps": NORM_EPS,
        "spread_eps": SPREAD_EPS,
        "log_sigma": list(LOG_SIGMA),
        "adapters": [list(adapter) for adapter in ADAPTERS],
    }


def paper_network(config):
    """The configuration of a network of the paper's form, as docs/weights.md has it; SystemExit for those that nothing else runs."""
    if config["gcn"] == "max":
        raise SystemExit("paper.gcn: max is for ablations alone and cannot be exported")
    sizes = {key: config[key] for key in ("photos", "width", "encoder_blocks", "middle_blocks", "decoder_blocks", "gcn", "roughness_floor")}
    return {**sizes, "lobe": "isotropic"}


def write(path, tensors, config, facts, dtype):
    """Write `tensors` in `dtype`; `config` is a whole configuration, `facts` are further metadata."""
    if config["network"] == "paper":
        settings = config["paper"]
        form = {"networks": json.dumps([paper_network(settings)])}
        tensors = tensors if settings["adapters"] else paper.with_adapters(tensors)
        tensors = {f"photos{settings['photos']}.{name}": tensor for name, tensor in tensors.items()}
    else:
        form = {"architecture": json.dumps(architecture(config["model"]))}
    tensors = {name: tensor.detach().to(dtype) for name, tensor in tensors.items()}
    for name, tensor in tensors.items():
        if not bool(torch.isfinite(tensor).all()):
            raise SystemExit(f"{name}: holds values that are not finite in {dtype}")
    store.save(path, tensors, {**CONVENTIONS, **form, **facts})


def export(folder, path, data, device, dtype, license):
    """Write the averaged weights of the training in `folder`, whose materials are `data`, to `path`."""
    place = folder / "checkpoint"
    state = json.loads((place / "state.json").read_text())
    average, _ = store.load(place / "average.safetensors")
    config = configuration.of_checkpoint(state)
    if config["network"] == "photo graph":
        model = configuration.network(config).to(device).eval()
        model.load_state_dict(average)
        factors, covered = calibrate(model, data, config["validation"], device)
        for name, factor in factors.items():
            share = f"; {100 * covered[name]:.0f} % of the errors on the other materials lie within one" if name in covered else ""
            print(f"{name}: standard deviations times {factor:.2f}{share}", flush=True)
        average["certainty.end.bias"] = model.certainty.end.bias.detach().cpu()
    summary = {"steps": state["step"], "seconds": round(state["seconds"]), "settings": state["config"]}
    log = folder / "log.jsonl"
    validations = [json.loads(line) for line in log.read_text().splitlines() if '"validation"' in line] if log.exists() else []
    if validations:
        summary["validation"] = validations[-1]
    facts = {"license": license, "data": json.dumps(data.facts), "training": json.dumps(summary)}
    write(path, average, config, facts, dtype)
    parameters = sum(tensor.numel() for tensor in average.values())
    print(f"{path}: {path.stat().st_size / 1e6:.2f} MB, {parameters / 1e6:.2f} M parameters, {state['step']} steps", flush=True)


def main(arguments=None):
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("-o", "--output", type=Path, required=True)
    parser.add_argument("--f32", action="store_true", help="single instead of half precision")
    parser.add_argument("--license", default="not stated", help="of the weights")
    parser.add_argument("--pack", help="the materials, if they are no longer where the configuration says")
    parser.add_argument("--device", default="cuda" if torch.cuda.is_available() else "cpu")
    options = parser.parse_args(arguments)
    try:
        state = json.loads((options.folder / "checkpoint" / "state.json").read_text())
        config = configuration.of_checkpoint(state)
        config["data"]["pack"] = options.pack or config["data"]["pack"]
        data = open_data(config)
    except (OSError, ValueError, SvbrdfError) as error:
        raise SystemExit(f"{options.folder}: {error}") from error
    dtype = torch.float32 if options.f32 else torch.float16
    export(options.folder, options.output, data, torch.device(options.device), dtype, options.license)


if __name__ == "__main__":
    main()
