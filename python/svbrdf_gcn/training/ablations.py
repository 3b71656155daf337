"""Trains the networks of the ablations: python -m svbrdf_gcn.training.ablations -o out/ablations [--only NAME,...]

Every variant of the paper's network (`paper-16`), with one seed, and of the small photo graph (`directions`), with two. What is finished is not
trained again; what was interrupted goes on. `make ablations` then makes docs/ablations.md of it.
"""

import argparse
import json
import subprocess
import sys
from pathlib import Path

# Name: configuration, changes, seeds.
VARIANTS = {
    "graph": ("paper-16", [], (1,)),
    "no-graph": ("paper-16", ['paper.gcn="none"'], (1,)),
    "max-pooling": ("paper-16", ['paper.gcn="max"'], (1,)),
    "no-adapters": ("paper-16", ["paper.adapters=false"], (1,)),
    "directions": ("directions", [], (1, 2)),
    "no-directions": ("directions", ["data.directions=false"], (1, 2)),
}
# Those that a fit can use; their weights are written beside their folders.
EXPORTED = ("graph", "no-graph", "no-adapters")


def steps(folder):
    """Steps of the checkpoint in `folder`, and how many its training has; (0, 1) where there is none."""
    path = folder / "checkpoint" / "state.json"
    if not path.exists():
        return 0, 1
    state = json.loads(path.read_text())
    return state["step"], state["config"]["steps"]


def main(arguments=None):
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-o", "--output", type=Path, required=True)
    parser.add_argument("--only", type=lambda text: text.split(","), default=list(VARIANTS), help="names of variants")
    options = parser.parse_args(arguments)
    for name in options.only:
        config, changes, seeds = VARIANTS[name]
        for seed in seeds:
            folder = options.output / f"{name}-{seed}"
            done, wanted = steps(folder)
            if done < wanted:
                settings = [word for change in (f"seed={seed}", *changes) for word in ("--set", change)]
                subprocess.run([sys.executable, "-m", "svbrdf_gcn.training", config, "-o", folder, *settings], check=True)
            if name in EXPORTED:
                subprocess.run([sys.executable, "-m", "svbrdf_gcn.training.export", folder, "-o", f"{folder}.safetensors", "--license", "CC0-1.0"], check=True)


if __name__ == "__main__":
    main()
