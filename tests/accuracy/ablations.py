#!/usr/bin/env python3
"""Measures the trainings of `svbrdf_gcn.training.ablations` and writes docs/ablations.md: ablations.py out/ablations [--binary svbrdf-gcn] [--report docs]

Two tables: what the networks predict by themselves on the held-out textures, as their trainings scored it; and what is left on the maps of Deschaintre
et al. of the stages of the paper's fit. Needs the measuring data and numpy; fits are kept in the folder.
"""

import argparse
import json
import multiprocessing
import os
import statistics
import subprocess
from pathlib import Path

os.environ.update(OPENBLAS_NUM_THREADS="1", OMP_NUM_THREADS="1")

import scenes  # noqa: E402
from metrics import rmse  # noqa: E402
from report import table, three  # noqa: E402
from shading import Maps, gamma22, render, unit  # noqa: E402

SIZE = 128
ADAPTER_STEPS, LATENT_STEPS = 300, 10
LABELS = {
    "graph": "graph convolution (Eq. 2), adapters",
    "no-graph": "without graph: one convolution",
    "max-pooling": "maximum over photos instead",
    "no-adapters": "graph, without adapters",
    "directions": "small photo graph",
    "no-directions": "the same, without light directions",
}
PAPER = ("graph", "no-graph", "max-pooling", "no-adapters")
SMALL = ("directions", "no-directions")
# Those that the command line runs; the maximum is no form of the paper's network.
FITTED = ("graph", "no-graph", "no-adapters")
STAGES = {"network only": (0, 0), "+ latent": (LATENT_STEPS, 0), "+ adapters": (0, ADAPTER_STEPS), "+ latent + adapters": (LATENT_STEPS, ADAPTER_STEPS)}
ERRORS = ("D", "N", "R", "S", "rendering")


def small(name):
    """True maps at SIZE pixels."""
    maps = scenes.linear_maps(name)
    return Maps(scenes.box(maps.diffuse, SIZE), unit(scenes.box(maps.normal, SIZE)), scenes.box(maps.roughness, SIZE), scenes.box(maps.specular, SIZE))


def validation(folder, name, seed):
    """The last scores of a training, by kind of capture."""
    lines = (folder / f"{name}-{seed}" / "log.jsonl").read_text().splitlines()
    return [json.loads(line) for line in lines if '"validation"' in line][-1]


def predictions(folder, names, seeds, kind):
    """Rows of the first tables: errors of the networks alone, those of the seeds side by side."""
    rows = []
    for name in names:
        scores = [validation(folder, name, seed)["validation"][kind] for seed in seeds]
        rows.append([LABELS[name], *(" / ".join(three(score[error]) for score in scores) for error in ERRORS)])
    return rows


def measure(job):
    """Re-rendering error of one material for every network and stage, by (network, stage)."""
    folder, binary, name = job
    truth = small(name)
    capture = folder / "captures" / name
    if not (capture / "light_power.txt").exists():
        scenes.write_capture(capture, truth)
    tests = [(place, gamma22(render(truth, place, place, scenes.INTENSITY, scenes.PATCH_SIZE))) for place in scenes.positions()[1]]
    out = {}
    for network in FITTED:
        for stage, (latent, adapters) in STAGES.items():
            if network == "no-adapters" and adapters:
                continue
            maps = folder / "fits" / f"{network}-{latent}-{adapters}" / name
            steps = ["--latent-steps", str(latent), "--adapter-steps", str(adapters), "--no-early-stop", "--threads", "1"]
            weights = folder / f"{network}-1.safetensors"
            command = [binary, "fit", capture, "--views", "0,1,2,3", "--weights", weights, *steps, "--format", "tiff", "-q", "-o", maps]
            maps.parent.mkdir(parents=True, exist_ok=True)
            subprocess.run(command, check=True)
            fitted, _ = scenes.load_fit(maps)
            pictures = (gamma22(render(fitted, place, place, scenes.INTENSITY, scenes.PATCH_SIZE)) for place, _ in tests)
            out[network, stage] = statistics.fmean(rmse(picture, true) for picture, (_, true) in zip(pictures, tests, strict=True))
    return out


TEXT = """# Ablations

What the parts of the paper's network and of its fit are worth, and light directions, at sizes of training that CPUs manage, on the same materials. Made by `make ablations` (trainings by
`svbrdf_gcn.training.ablations`; measured by `tests/accuracy/ablations.py`). The authors trained a network sixteen times as large for three days on four GPUs: these tables tell what is learned first, not what is better in the end.

## The paper's network
At width 16 (7.4 M parameters; `paper-16.toml`), {steps} steps of four crops of 96 x 96 pixels, an hour of one core each (or half an hour of two), one seed. Captures of four photos from near and far, with all defects; the network
does not know where camera and light stood. 24 textures held out of training, 128 x 128 pixels, with a perfect camera (`near`) and with defects (`real`): RMSE of linear diffuse, of (n + 1) / 2, roughness, specular, and of 20 renderings
in gamma 2.2.

{paper_near}

{paper_real}

## Light directions
A small photo graph ({parameters:.2f} M parameters, `directions.toml`), {small_steps} steps on the same captures, with and without the planes that follow from camera and light (ratio to white, directions, half vectors, hints). Cells are two seeds.

{small_near}

{small_real}

## The stages of the paper's fit
Re-rendering error (20 places, gamma 2.2) on the twelve maps of Deschaintre et al. at 128 x 128 pixels, four photos, camera and light together 2.146 half widths above the patch; {latent} steps on the latent code, {adapters} on the adapters. Without adapters
there is nothing to optimise in them.

{fits}

## What they say
- **Light directions** are worth most: without them errors of diffuse albedo and of renderings grow by far more than by any other change here. This is why the default network is given them.
- **The graph of Eq. 2** comes after one plain convolution of all photos. It is no matter of its start: from the identity instead of ones (each channel keeps its own at first) it ends at the same errors (.075 and .081, near and real).
  The paper finds the reverse after a full training; nothing here contradicts that, and nothing confirms it.
- **The stages:** what the fit lives on is the optimisation of the adapters. Ten steps on the latent code take away next to nothing, before or without it.
- **Normals** are as flat with all of the paper's networks: trainings of this length teach colours and gloss, not relief.
"""


def main(arguments=None):
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path, help="what svbrdf_gcn.training.ablations wrote")
    parser.add_argument("--binary", type=Path, default=scenes.ROOT / "target" / "release" / "svbrdf-gcn")
    parser.add_argument("--report", type=Path, default=scenes.ROOT / "docs")
    options = parser.parse_args(arguments)
    kept = options.folder / "fits.json"
    if not kept.exists():
        jobs = [(options.folder, options.binary, name) for name in scenes.names("maps")]
        with multiprocessing.get_context("spawn").Pool(os.cpu_count()) as pool:
            found = pool.map(measure, jobs, chunksize=1)
        means = {key: statistics.fmean(errors[key] for errors in found) for key in found[0]}
        kept.write_text(json.dumps([[*key, value] for key, value in means.items()], indent=1))
    means = {tuple(key): value for *key, value in json.loads(kept.read_text())}
    rows = [[LABELS[network], *(three(means[network, stage]) if (network, stage) in means else "–" for stage in STAGES)] for network in FITTED]
    tables = {
        f"{group}_{kind}": table((kind, *ERRORS), predictions(options.folder, names, seeds, f"{kind} 4"))
        for group, names, seeds in (("paper", PAPER, (1,)), ("small", SMALL, (1, 2)))
        for kind in ("near", "real")
    }
    weights = options.folder / "directions-1" / "checkpoint" / "average.safetensors"
    text = TEXT.format(
        steps=validation(options.folder, "graph", 1)["step"],
        small_steps=validation(options.folder, "directions", 1)["step"],
        parameters=weights.stat().st_size / 4e6,
        latent=LATENT_STEPS,
        adapters=ADAPTER_STEPS,
        fits=table(("", *STAGES), rows),
        **tables,
    )
    (options.report / "ablations.md").write_text(text)
    print(options.report / "ablations.md")


if __name__ == "__main__":
    main()
