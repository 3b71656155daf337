"""Batches for training: what a step sees follows from the seed and the step's number alone."""

import torch

import camera
from augment import augmented
from library import ProceduralPool, draw_crops, halved, open_pack


class Data:
    """Training materials and captures of them, all on `device`."""

    def __init__(self, config, device):
        self.config, self.device = config, device
        settings = config["data"]
        names, bank = open_pack(settings["pack"], validation=False)
        self.names = names
        self.levels = [bank.to(device)]
        self.levels.append(halved(self.levels[0]))
        self.pool = ProceduralPool(config["seed"], settings["groups"], settings["per_group"], settings["refresh"], settings["size"], device)

    def generators(self, step):
        """Random numbers of step `step`, on the CPU and on the device."""
        pair = torch.Generator(), torch.Generator(self.device)
        for number, generator in enumerate(pair):
            generator.manual_seed((self.config["seed"] * 1_000_003 + step) * 2 + number)
        return pair

    def materials(self, step, count, size, rng):
        """Maps (count, 10, size, size) of augmented crops."""
        procedural = round(count * self.config["data"]["procedural"])
        crops = []
        if count > procedural:
            crops.append(draw_crops(rng, self.levels, count - procedural, size))
        if procedural:
            crops.append(draw_crops(rng, self.pool.levels(step), procedural, size))
        return augmented(torch.cat(crops)[torch.randperm(count, generator=rng).to(self.device)], rng)

    def captures(self, step, count, size):
        """The captures of step `step`, and the generator that drew them."""
        rng, noise_rng = self.generators(step)
        photos = 1 + int(torch.multinomial(torch.tensor(self.config["photos"], dtype=torch.float), 1, generator=rng))
        maps = self.materials(step, count, size, rng)
        if self.config["data"]["captures"] == "paper":
            geometry = camera.draw_geometry(rng, count, photos, size, size, self.device, "paper")
            return camera.Capture(*camera.clean_photos(maps, geometry), geometry, maps), rng
        geometry = camera.draw_geometry(rng, count, photos, size, size, self.device)
        return camera.photograph(maps, geometry, rng, noise_rng), rng
