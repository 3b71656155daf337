"""Training configurations: TOML files, every setting with its default here."""

import copy
import tomllib
from pathlib import Path

from . import model, paper

DEFAULTS = {
    "seed": 1,
    # Length of the whole training, over any number of calls: steps, or seconds of training if steps is 0.
    "steps": 0,
    "seconds": 1440,
    "data": {
        # A pack (`pack.py`) or a folder of material folders.
        "pack": "data/materials.zip",
        # Share of procedural materials in a batch, and the pool they come from.
        "procedural": 0.45,
        "groups": 56,
        "per_group": 6,
        "refresh": 2,
        "size": 320,
        # What captures are: `any`, with every defect, or `paper`, those of the synthetic literature, without defects.
        "captures": "any",
        # Whether the network is shown where camera and light stood; false for the ablation.
        "directions": True,
    },
    # How often a batch has 1, 2, ... 9 photos, relatively.
    "photos": [3, 2, 2, 4, 2, 0, 2, 0, 1.5],
    # What part of the training runs with which crops; the last size is the model's window.
    "phase": [{"share": 1.0, "size": 128, "batch": 32}],
    # `photo graph`, with the sizes under `model`, or `paper`, with those under `paper`.
    "network": "photo graph",
    "paper": paper.DEFAULT,
    "model": {key: value for key, value in model.DEFAULT.items() if key != "window"},
    "optimiser": {"rate": 1e-3, "final_rate": 1e-6, "warmup": 0.02, "decay": 1e-4, "betas": [0.9, 0.95], "clip": 1.0, "average": 0.999},
    # Weights of the losses: maps and renderings as in the paper, and certainty.
    "loss": {"maps": 10.0, "rendering": 1.0, "views": 9, "certainty": 0.1},
    "validation": {"minutes": 6.0, "size": 256, "photos": [1, 4, 8], "views": 20},
    "log_steps": 50,
    "checkpoint_minutes": 4.0,
    # Memory layout of the network.
    "channels_last": True,
    # The network behind the input in bfloat16; rendering, loss and adapters stay in single precision.
    "bfloat16": True,
    # Time the GPU's algorithms of every convolution and shape, and take the fastest (seconds at the start of every call).
    "benchmark": True,
    # Compile the part of the network behind the pooling (a minute at the start, on a GPU).
    "compile": False,
}


def merged(defaults, given, place=""):
    out = copy.deepcopy(defaults)
    for key, value in given.items():
        if key not in defaults:
            raise ValueError(f"{place}{key}: there is no such setting")
        default = defaults[key]
        if isinstance(default, dict):
            value = merged(default, value, f"{place}{key}.")
        elif not isinstance(value, (int, float) if isinstance(default, float) else type(default)):
            raise ValueError(f"{place}{key}: expected a value like {default!r}, got {value!r}")
        out[key] = value
    return out


def load(path, changes=()):
    """The configuration in the file `path`, or of that name beside this module (`default`), with `changes` such as `optimiser.rate=2e-4`.

    OSError if there is none, ValueError naming setting and values for all else.
    """
    path = Path(path)
    shipped = Path(__file__).with_name(f"{path.name}.toml")
    with open(shipped if path.parent == Path() and not path.exists() and shipped.exists() else path, "rb") as file:
        given = tomllib.load(file)
    for change in changes:
        key, _, value = change.partition("=")
        *tables, last = key.strip().split(".")
        table = given
        for name in tables:
            table = table.setdefault(name, {})
            if not isinstance(table, dict):
                raise ValueError(f"--set {change}: {name} has no settings of its own")
        table[last] = tomllib.loads(f"value = {value}")["value"]
    config = merged(DEFAULTS, given)
    for key, known, value in (("network", ("photo graph", "paper"), config["network"]), ("data.captures", ("any", "paper"), config["data"]["captures"])):
        if value not in known:
            raise ValueError(f"{key}: expected one of {', '.join(known)}, got {value}")
    if config["network"] == "paper":
        wanted = config["paper"]["photos"]
        if config["validation"]["photos"] != [wanted] or [bool(share) for share in config["photos"]] != [False] * (wanted - 1) + [True]:
            raise ValueError(f"photos, validation.photos: expected captures of {wanted} photos alone, as paper.photos says")
    for name, least, value in (("phase.size", 8, min(phase["size"] for phase in config["phase"])), ("phase.batch", 1, min(phase["batch"] for phase in config["phase"])),
                               ("log_steps", 1, config["log_steps"]), ("validation.views", 1, config["validation"]["views"]), ("optimiser.clip", 1e-9, config["optimiser"]["clip"])):  # fmt: skip
        if value < least:
            raise ValueError(f"{name}: expected {least} or more, got {value}")
    if not config["steps"] and config["seconds"] <= 0:
        raise ValueError(f"seconds: expected a number above 0 where steps is 0, got {config['seconds']}")
    total = sum(phase["share"] for phase in config["phase"])
    if abs(total - 1) > 1e-6:
        raise ValueError(f"phase.share: expected a sum of 1, got {total}")
    config["model"]["window"] = config["phase"][-1]["size"]
    return config


def network(config):
    """The network of a configuration, with new weights."""
    return paper.Paper(config["paper"]) if config["network"] == "paper" else model.Model(config["model"])


def of_checkpoint(state):
    """The configuration in a checkpoint's `state.json`; old ones lack the newest settings."""
    config = {**DEFAULTS, **state["config"]}
    return {**config, "data": {**DEFAULTS["data"], **config["data"]}}


def can_be_exported(config):
    """Whether anything else runs such a network: the maximum over photos is for ablations alone."""
    return config["network"] == "photo graph" or config["paper"]["gcn"] != "max"


def phase_at(config, progress):
    """The phase at `progress` from 0 to 1."""
    for phase in config["phase"]:
        progress -= phase["share"]
        if progress < 0:
            return phase
    return config["phase"][-1]
