"""Trains the networks of the ablations: python -m svbrdf_gcn.training.ablations -o out/ablations [--only NAME,...]

Every variant of the paper's network (`paper-16`) and of the small photo graph (`directions`) for as many steps, with two seeds. What is finished is
not trained again; what was interrupted goes on. `make ablations` then makes
docs/ablations.md of it.
"""

import argparse
import json
import subprocess
import sys
from pathlib import Path

SEEDS = (1, 2)
# Name: configuration, changes.
VARIANTS = {
    "graph": ("paper-16", []),
    "no-graph": ("paper-16", ['paper.gcn="none"']),
    "max-pooling": ("paper-16", ['paper.gcn="max"']),
    "no-adapters": ("paper-16", ["paper.adapters=false"]),
    "directions": ("directions", []),
    "no-directions": ("directions", ["data.directions=false"]),
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
    for seed in SEEDS:
        for name in options.only:
            config, changes = VARIANTS[name]
            folder = options.output / f"{name}-{seed}"
            done, wanted = steps(folder)
            if done < wanted:
                settings = [word for change in (f"seed={seed}", *changes) for word in ("--set", change)]
                subprocess.run([sys.executable, "-m", "svbrdf_gcn.training", config, "-o", folder, *settings], check=True)
            if name in EXPORTED:
                subprocess.run([sys.executable, "-m", "svbrdf_gcn.training.export", folder, "-o", f"{folder}.safetensors", "--license", "CC0-1.0"], check=True)


if __name__ == "__main__":
    main()
