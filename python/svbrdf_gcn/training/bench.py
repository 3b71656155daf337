"""Times the parts of a training step: python -m svbrdf_gcn.training.bench CONFIG [--photos 4] [--steps 10] [--set compile=true ...]

For every phase of the configuration: milliseconds for data (materials, captures, network input), for the network forward and
backward with the loss, and for a whole step, which on a GPU draws the next batch meanwhile, after three to warm up. Use it to choose `channels_last` and `compile`.
"""

import argparse
import time

import torch

from . import configuration
from .data import Batches, open_data, tensors
from .losses import losses
from .train import Trainer


def main(arguments=None):
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("config")
    parser.add_argument("--photos", type=int, default=4)
    parser.add_argument("--steps", type=int, default=10)
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE")
    parser.add_argument("--device", default="cuda" if torch.cuda.is_available() else "cpu")
    options = parser.parse_args(arguments)
    config = configuration.load(options.config, options.set)
    config["photos"] = [float(number == options.photos) for number in range(1, 10)]
    device = torch.device(options.device)
    torch.backends.cuda.matmul.allow_tf32 = torch.backends.cudnn.allow_tf32 = True
    torch.backends.cudnn.benchmark = config["benchmark"]
    data = open_data(config)

    def wait():
        if device.type == "cuda":
            torch.cuda.synchronize()

    def timed(function):
        for step in range(3):
            function(step)
        wait()
        begin = time.perf_counter()
        for step in range(3, 3 + options.steps):
            function(step)
        wait()
        return (time.perf_counter() - begin) / options.steps * 1000

    for phase in config["phase"]:
        trainer = Trainer(config, device)
        trainer.config = {**config, "phase": [{**phase, "share": 1.0}]}

        batch = tensors(data.batch(0, phase["batch"], phase["size"]), device)
        batches = Batches(data, device)

        def network(_):
            with trainer.autocast():
                raw, log_sigma = trainer.model(batch["inputs"], None)
            floor = trainer.model.config["roughness_floor"]
            losses(raw, log_sigma, batch["maps"], batch["views"], config["loss"], floor)["loss"].backward()

        times = (
            timed(lambda step: data.batch(step, phase["batch"], phase["size"])),
            timed(network),
            timed(lambda step: trainer.descend(batches.take(step, phase))),
        )
        memory = torch.cuda.max_memory_allocated() / 2**30 if device.type == "cuda" else 0
        print(
            f"{phase['batch']} crops of {phase['size']}, {options.photos} photos: data {times[0]:.1f} ms, network {times[1]:.1f} ms, "
            f"step {times[2]:.1f} ms, {1000 * phase['batch'] / times[2]:.0f} crops/s, {memory:.1f} GiB",
            flush=True,
        )


if __name__ == "__main__":
    main()
