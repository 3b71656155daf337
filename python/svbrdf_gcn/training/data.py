"""Batches as tensors."""

from concurrent.futures import ThreadPoolExecutor

import torch

from . import TrainingData


def open_data(config, threads=None):
    """The materials of a configuration, and captures of them."""
    settings = config["data"]
    shares = {name: settings[name] for name in ("procedural", "groups", "per_group", "refresh", "size", "captures", "directions")}
    return TrainingData(settings["pack"], seed=config["seed"], photos=config["photos"], views=config["loss"]["views"], threads=threads, **shares)


def tensors(batch, device):
    """The arrays of a batch on `device`."""
    return {name: torch.from_numpy(array).to(device, non_blocking=True) for name, array in batch.items()}


class Batches:
    """What every step sees. While a GPU learns from one batch, the next is drawn; on a CPU both would take from the same."""

    def __init__(self, data, device):
        self.data, self.device = data, device
        self.worker = ThreadPoolExecutor(1)
        self.asked, self.coming = None, None

    def ask(self, *asked):
        """Begin to draw the batch of a step, of so many captures of such a size."""
        self.asked, self.coming = asked, self.worker.submit(self.data.batch, *asked)

    def take(self, step, phase):
        """The batch of step `step` in a phase of the configuration."""
        wanted = (step, phase["batch"], phase["size"])
        if self.asked != wanted:
            self.ask(*wanted)
        batch = self.coming.result()
        if self.device.type != "cpu":
            self.ask(step + 1, *wanted[1:])
        return tensors(batch, self.device)
