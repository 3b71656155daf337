#!/usr/bin/env python3
"""Writes the averaged weights of a training as one safetensors file: export.py FOLDER -o weights.safetensors [--f32]

Tensors are named as in model.py. The metadata state what a reader must know: the architecture as JSON, the conventions of maps and photos, the
licence, what the weights were trained on, and the last validation.
"""

import argparse
import json
import zipfile
from collections import Counter
from pathlib import Path

import torch

import paper
import store
from store import checksums
from camera import RATIO_MAX
from model import ADAPTERS, HINT_RIDGE, LOG_SIGMA, NORM_EPS, SPREAD_EPS

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
    # Checkpoints of the Rust trainer, and old ones, do not name the network.
    if config.get("network") == "paper":
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


def training_data(pack):
    """What the materials of a pack are, and under which licences."""
    with zipfile.ZipFile(pack) as archive:
        materials = json.loads(archive.read("materials.json"))["materials"]
    used = [entry for entry in materials if not entry.get("validation")]
    licences = Counter(entry.get("licence", "not stated") for entry in used)
    held = sorted(entry["name"] for entry in materials if entry.get("validation"))
    return {"materials": len(used), "licences": dict(licences.most_common()), "held_out": held, "procedural": "python/training/procedural.py"}


def main(arguments=None):
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("-o", "--output", type=Path, required=True)
    parser.add_argument("--f32", action="store_true", help="single instead of half precision")
    parser.add_argument("--license", default="CC0-1.0", help="of the weights; the default is for the project's own data")
    parser.add_argument("--pack", type=Path, help="the pack, if it is no longer where the configuration says")
    options = parser.parse_args(arguments)

    place = options.folder / "checkpoint"
    state = json.loads((place / "state.json").read_text())
    average, _ = store.load(place / "average.safetensors")
    config = state["config"]
    validations = [json.loads(line) for line in (options.folder / "log.jsonl").read_text().splitlines() if '"validation"' in line]
    summary = {"steps": state["step"], "seconds": round(state["seconds"]), "settings": config}
    if validations:
        summary["validation"] = validations[-1]
    facts = {
        "license": options.license,
        "data": json.dumps(training_data(options.pack or config["data"]["pack"])),
        "training": json.dumps(summary),
    }
    write(options.output, average, config, facts, torch.float32 if options.f32 else torch.float16)
    print(f"{options.output}: {options.output.stat().st_size / 1e6:.2f} MB, {sum(t.numel() for t in average.values()) / 1e6:.2f} M parameters, {state['step']} steps")


if __name__ == "__main__":
    main()
