"""Trains a network: python -m svbrdf_gcn.training CONFIG -o FOLDER [--library MATERIALS ...] [--from WEIGHTS] [--seconds 540] [--set optimiser.rate=5e-4 ...]

CONFIG is a TOML file, or the name of one that comes with the package: default, large, smoke, paper-16 ...

Goes on from FOLDER/checkpoint if there is one, exactly where it stopped: random numbers follow from seed and step. FOLDER/log.jsonl gets a
line every few steps and one per validation. With --seconds the call ends in time, with a checkpoint; so it does after Ctrl-C. At the end of the schedule the
averaged weights are calibrated and written to FOLDER/weights.safetensors. With --library the folders of materials are packed first, where the configuration's
pack is not there. With --from a new training begins at the weights of an exported file, with fresh moments and its own schedule; a folder that holds a
checkpoint already goes on from that.
"""

import argparse
import json
import math
import os
import shutil
import signal
import time
from pathlib import Path

import torch

from ..errors import SvbrdfError
from . import configuration, export, pack, store
from .data import Batches, open_data
from .losses import losses
from .model import cost
from .validate import summary, validate

STATES = ("model", "average", "moment1", "moment2")


class Trainer:
    """Network, optimiser, moving average and position in the schedule."""

    def __init__(self, config, device):
        self.config, self.device = config, device
        torch.manual_seed(config["seed"])
        self.model = configuration.network(config)
        if config["channels_last"]:
            self.model.memory_format = torch.channels_last
        self.model.to(device, memory_format=self.model.memory_format)
        self.model.train()
        self.named = dict(self.model.named_parameters())
        settings = config["optimiser"]
        # Decay acts on the kernels of convolutions alone.
        groups = [
            {"params": [p for p in self.named.values() if p.dim() == 4], "weight_decay": settings["decay"]},
            {"params": [p for p in self.named.values() if p.dim() != 4], "weight_decay": 0.0},
        ]
        fused = {"fused": True} if device.type == "cuda" else {}
        self.optimiser = torch.optim.AdamW(groups, lr=settings["rate"], betas=tuple(settings["betas"]), **fused)
        self.average = {name: p.detach().clone() for name, p in self.named.items()}
        self.step, self.seconds = 0, 0.0
        if config["compile"] and device.type == "cuda" and config["network"] == "photo graph":
            self.model.restore = torch.compile(self.model.restore)

    @property
    def progress(self):
        """From 0 to 1 over the whole training."""
        return self.step / self.config["steps"] if self.config["steps"] else self.seconds / self.config["seconds"]

    def rate(self):
        settings = self.config["optimiser"]
        if self.progress < settings["warmup"]:
            return settings["rate"] * (self.progress / settings["warmup"] + 1e-3)
        phase = min((self.progress - settings["warmup"]) / (1 - settings["warmup"]), 1.0)
        return settings["final_rate"] + (settings["rate"] - settings["final_rate"]) * 0.5 * (1 + math.cos(math.pi * phase))

    def autocast(self):
        return torch.autocast(self.device.type, torch.bfloat16, enabled=self.config["bfloat16"])

    def phase(self):
        """The present phase of the configuration."""
        return configuration.phase_at(self.config, self.progress)

    def descend(self, batch):
        """One step of the optimiser; returns what it measured, as tensors."""
        with self.autocast():
            raw, log_sigma = self.model(batch["inputs"], None)
        parts = losses(raw, log_sigma, batch["maps"], batch["views"], self.config["loss"], self.model.config["roughness_floor"])
        self.optimiser.zero_grad(set_to_none=True)
        parts["loss"].backward()
        norm = torch.nn.utils.clip_grad_norm_(self.named.values(), self.config["optimiser"]["clip"])
        rate = self.rate()
        for group in self.optimiser.param_groups:
            group["lr"] = rate
        finite = bool(torch.isfinite(norm))
        if finite:
            self.optimiser.step()
            weight = min(self.config["optimiser"]["average"], (1 + self.step) / (10 + self.step))
            with torch.no_grad():
                averages = list(self.average.values())
                torch._foreach_mul_(averages, weight)
                torch._foreach_add_(averages, [p.detach() for p in self.named.values()], alpha=1 - weight)
        self.step += 1
        measured = {name: part.detach() for name, part in parts.items()}
        return {**measured, "norm": norm.detach() if finite else torch.zeros_like(norm), "skipped": 1.0 - finite}

    def averaged(self):
        """The network with the moving average of its weights."""
        model = configuration.network(self.config).to(self.device)
        model.memory_format = self.model.memory_format
        model.load_state_dict(self.average)
        return model

    def tensors(self):
        """What a checkpoint holds, by file. Every file is as large as the weights in f32."""
        state = self.optimiser.state
        moments = [{n: state[p][key] if p in state else torch.zeros_like(p) for n, p in self.named.items()} for key in ("exp_avg", "exp_avg_sq")]
        return dict(zip(STATES, [self.named, self.average, *moments]))

    def save(self, folder):
        """Write FOLDER/checkpoint; the one before stays until the new one is whole."""
        folder = Path(folder)
        fresh, place, old = (folder / name for name in ("checkpoint.part", "checkpoint", "checkpoint.old"))
        shutil.rmtree(fresh, ignore_errors=True)
        fresh.mkdir(parents=True)
        for name, tensors in self.tensors().items():
            store.save(fresh / f"{name}.safetensors", tensors)
        state = {"step": self.step, "seconds": self.seconds, "config": self.config}
        (fresh / "state.json").write_text(json.dumps(state, indent=1))
        shutil.rmtree(old, ignore_errors=True)
        if place.exists():
            os.rename(place, old)
        os.rename(fresh, place)
        shutil.rmtree(old, ignore_errors=True)

    def start_from(self, path):
        """Begin at the weights of an exported file; the optimiser, the schedule and the moving average start afresh."""
        weights, metadata = store.load(path)
        architecture = json.loads(metadata.get("architecture", "{}"))
        # The window decides over how many pixels attention averages; no tensor depends on it.
        differing = [key for key in self.config["model"] if key != "window" and architecture.get(key) != self.config["model"][key]]
        if differing or {n: t.shape for n, t in weights.items()} != {n: p.shape for n, p in self.named.items()}:
            raise SystemExit(f"--from {path}: its network differs from the configuration's in {', '.join(differing) or 'its tensors'}")
        with torch.no_grad():
            for name, p in self.named.items():
                p.copy_(weights[name])
                self.average[name].copy_(weights[name])

    def load(self, folder):
        """Go on from FOLDER/checkpoint. Without the files of the moments the optimiser starts afresh, and says so."""
        place = Path(folder) / "checkpoint"
        if not place.exists():
            place = Path(folder) / "checkpoint.old"
        state = json.loads((place / "state.json").read_text())
        for key in ("network", "model", "paper"):
            # Checkpoints of before there were two kinds of network lack the others.
            if state["config"].get(key, self.config[key]) != self.config[key]:
                raise SystemExit(f"{place}: its network differs from the configuration's: {key} is {state['config'][key]}")
        changed = [key for key in self.config if state["config"].get(key) != self.config[key]]
        if changed:
            print(f"changed since the checkpoint: {', '.join(changed)}", flush=True)
        self.step, self.seconds = state["step"], state["seconds"]
        files = {name: place / f"{name}.safetensors" for name in STATES}
        values = {name: store.load(path)[0] for name, path in files.items() if path.exists()}
        with torch.no_grad():
            for name, p in self.named.items():
                p.copy_(values["model"][name])
                self.average[name].copy_(values["average"][name])
        if "moment1" not in values or "moment2" not in values:
            print(f"{place}: no moments: the optimiser starts afresh", flush=True)
            return
        for name, p in self.named.items():
            first, second = (values[key][name].to(self.device) for key in STATES[2:])
            fused = self.optimiser.defaults.get("fused")
            count = torch.tensor(float(self.step), device=self.device if fused else "cpu")
            layout = {"memory_format": torch.preserve_format}
            self.optimiser.state[p] = {
                "step": count,
                "exp_avg": torch.zeros_like(p, **layout).copy_(first),
                "exp_avg_sq": torch.zeros_like(p, **layout).copy_(second),
            }


def main(arguments=None):
    parser = argparse.ArgumentParser(prog="svbrdf-gcn train", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("config")
    parser.add_argument("-o", "--output", type=Path, required=True, metavar="FOLDER")
    parser.add_argument("--library", type=Path, nargs="+", metavar="MATERIALS", help="folders of materials to pack into data.pack if it is not there")
    parser.add_argument("--from", dest="start", type=Path, metavar="WEIGHTS", help="begin a new training at these exported weights")
    parser.add_argument("--seconds", type=float, default=math.inf, help="end the call after so many seconds")
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE", help="change a setting")
    parser.add_argument("--license", default="not stated", help="of the weights that are written at the end")
    parser.add_argument("--device", default="cuda" if torch.cuda.is_available() else "cpu")
    options = parser.parse_args(arguments)
    begin = time.monotonic()
    try:
        config = configuration.load(options.config, options.set)
        if options.library and not Path(config["data"]["pack"]).exists():
            pack.main([*map(str, options.library), "-o", config["data"]["pack"]])
        data = open_data(config)
    except (OSError, ValueError, SvbrdfError) as error:
        raise SystemExit(f"{options.config}: {error}") from error
    stopped = []
    handlers = {number: signal.signal(number, lambda *_: stopped.append(True)) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        train(config, data, options, begin, stopped)
    finally:
        for number, handler in handlers.items():
            signal.signal(number, handler)


def train(config, data, options, begin, stopped):
    """The loop, from the checkpoint to the end of the schedule or of the call, which began at the time `begin` and ends early if `stopped` is not empty."""
    device = torch.device(options.device)
    torch.backends.cuda.matmul.allow_tf32 = torch.backends.cudnn.allow_tf32 = True
    torch.backends.cudnn.benchmark = config["benchmark"]

    trainer = Trainer(config, device)
    options.output.mkdir(parents=True, exist_ok=True)
    if (options.output / "checkpoint").exists() or (options.output / "checkpoint.old").exists():
        trainer.load(options.output)
    elif options.start:
        trainer.start_from(options.start)
    batches = Batches(data, device)
    parameters, multiply_adds = cost(configuration.network(config))
    print(
        f"{data.materials} materials, {len(data.held_out)} held out; {parameters / 1e6:.2f} M parameters, "
        f"{multiply_adds / 1e9:.1f} G multiply-adds for four photos of 256 x 256; {device}; from step {trainer.step}",
        flush=True,
    )

    def write(entry):
        with open(options.output / "log.jsonl", "a", encoding="utf-8") as log:
            log.write(json.dumps(entry) + "\n")

    def check():
        """Judge the averaged weights; returns the seconds that it took."""
        begin = time.monotonic()
        torch.backends.cudnn.benchmark = False
        results = validate(trainer.averaged(), data, config, device)
        torch.backends.cudnn.benchmark = config["benchmark"]
        write({"step": trainer.step, "seconds": round(trainer.seconds, 1), "validation": results})
        print(f"step {trainer.step}, validation\n{summary(results)}", flush=True)
        return time.monotonic() - begin

    saved = checked = mark = time.monotonic()
    sums, count = {}, 0
    # What a validation and a checkpoint take at the end of the call; the first validation measures it.
    reserve = 20.0 if device.type == "cuda" else 60.0
    while trainer.progress < 1 and not stopped and time.monotonic() - begin < options.seconds - reserve:
        measured = trainer.descend(batches.take(trainer.step, trainer.phase()))
        now = time.monotonic()
        trainer.seconds += now - mark
        mark = now
        sums = {name: sums.get(name, 0) + value for name, value in measured.items()}
        count += 1
        if count == config["log_steps"] or trainer.step == 1 or trainer.progress >= 1:
            means = {name: round(float(value) / count, 5) for name, value in sums.items()}
            mark = time.monotonic()
            trainer.seconds += mark - now
            write({"step": trainer.step, "seconds": round(trainer.seconds, 2), "rate": trainer.rate(), **means})
            print(f"step {trainer.step} {trainer.seconds:.0f} s: loss {means['loss']:.3f} maps {means['maps']:.4f} rendering {means['rendering']:.4f} certainty {means['certainty']:.2f}", flush=True)  # fmt: skip
            sums, count = {}, 0
        now = time.monotonic()
        if now - saved > 60 * config["checkpoint_minutes"]:
            trainer.save(options.output)
            saved = time.monotonic()
        if now - checked > 60 * config["validation"]["minutes"]:
            reserve = 5.0 + check()
            checked = time.monotonic()
        mark += time.monotonic() - now
    trainer.save(options.output)
    if not stopped:
        check()
    if trainer.progress >= 1 and not stopped and configuration.can_be_exported(config):
        export.export(options.output, options.output / "weights.safetensors", data, device, torch.float16, options.license)
    print(f"{trainer.step} steps, {trainer.seconds:.0f} s of training, {100 * min(trainer.progress, 1):.1f} % of the schedule", flush=True)


if __name__ == "__main__":
    main()
