#!/usr/bin/env python3
"""Makes tests/fixtures/default and tests/fixtures/training with tiny networks of the default architecture, in double precision.

    fixture.py tests/fixtures

`default`: a network with random weights, and what it answers. `weights.safetensors` is as export.py writes it (f32). `expected.safetensors`: three photos of 14 x 18 pixels (no multiple of the
coarsest pixel), `photos`, `saturated`, stated `camera`, `light`, `intensity` in units of half the patch's width (patch_size 2), the
network's `inputs`, their `hints` when continued with zeros to 16 x 24 pixels, and `raw`, `log_sigma`, `maps` with channel attention over
windows of 16 pixels; `raw_global` with global averages; `raw_single` of the first photo alone.

`training`: three steps of the trainer on one batch of two examples, of three photos of 18 x 22 pixels each. `steps.safetensors` has the
`inputs`, `maps` and views (`camera`, `light`, `intensity`) of the batch and every parameter's value at the start (`start.NAME`) in f32, and
in f64 the `rate` and what each step measured (`measured.NAME`), and the clipped gradients of the first step (`gradient.NAME`). `checkpoint` is
that of the trainer after the last, in f32.
"""

import sys
from pathlib import Path

import torch
import torch.nn.functional as functional

import camera
import configuration
import export
import store
from losses import draw_views
from maps import decode_maps, join, normal_from_slopes
from model import Model, hints
from render import pixel_positions
from train import Trainer

CONFIG = {"stem": 4, "stem_blocks": 1, "node": 4, "heads": 2, "dim": 2, "rounds": 2, "width": 4, "blocks": [1, 1], "middle": 1, "tail": 5, "tail_blocks": 1, "feature": 9, "window": 16, "roughness_floor": -0.5}  # fmt: skip
SEED = 20_240_102

TRAINED = {**CONFIG, "stem": 3, "width": 3, "blocks": [1], "tail": 4, "feature": 3, "window": 24}
# Steps, and the size of what they see. Clipping shortens the gradients of all of them.
STEPS, EXAMPLES, PHOTOS, HEIGHT, WIDTH = 3, 2, 3, 18, 22
SETTINGS = {"steps": 10, "bfloat16": False, "loss": {"views": 3}, "optimiser": {"decay": 0.1, "clip": 0.5}}


def random_weights(config, rng):
    """Random tensors of a network."""
    weights = {}
    for name, parameter in Model(config).named_parameters():
        spread = 0.7 * parameter[0].numel() ** -0.5 if parameter.dim() == 4 else 0.3
        centre = 1.0 if name.endswith(("norm1.weight", "norm2.weight", "norm.weight")) else 0.0
        weights[name] = centre + spread * torch.randn(parameter.shape, generator=rng)
    return weights


def made_up():
    """Random tensors of the network, and photos with their geometry, in f32."""
    rng = torch.Generator().manual_seed(SEED)
    weights = random_weights(CONFIG, rng)
    photos = (torch.rand(3, 3, 14, 18, generator=rng) * 1.1).clamp_max(1)
    place = torch.tensor([[0.1, -0.2, 2.5], [1.2, 0.4, 3.0], [-2.0, 1.5, 5.0]])
    return weights, {
        "photos": photos,
        "saturated": (photos.amax(1, keepdim=True) >= 1).float(),
        "camera": place,
        "light": place + torch.tensor([[0.0, 0.0, 0.0], [0.1, 0.0, -0.05], [3.0, -1.0, 0.5]]),
        "intensity": torch.tensor([[20.0, 21.0, 19.0], [30.0, 28.0, 31.0], [90.0, 80.0, 85.0]]),
    }


def answers(weights, given):
    """What the network of these weights makes of the photos, computed in f64."""
    model = Model(CONFIG).double()
    model.load_state_dict({name: tensor.double() for name, tensor in weights.items()})
    given = {name: tensor.double()[None] for name, tensor in given.items()}
    position = pixel_positions(*given["photos"].shape[-2:], dtype=torch.float64)[None]
    geometry = camera.Geometry(given["camera"], given["light"], given["intensity"], position)
    with torch.no_grad():
        inputs = camera.network_input(given["photos"], given["saturated"], geometry)
        raw, log_sigma = model(inputs)
        out = {"inputs": inputs, "raw": raw, "log_sigma": log_sigma, "maps": decode_maps(raw, CONFIG["roughness_floor"])}
        out.update(raw_global=model(inputs, None)[0], raw_single=model(inputs[:, :1])[0])
        out["hints"] = hints(functional.pad(inputs, (0, 6, 0, 2)))
    return {name: tensor[0].float() for name, tensor in out.items()}


def batch():
    """Inputs and maps of smooth materials with an edge, and the views that the losses draw, all representable in f32."""
    rng = torch.Generator().manual_seed(SEED)
    y, x = torch.meshgrid(torch.linspace(0, 1, HEIGHT), torch.linspace(0, 1, WIDTH), indexing="ij")

    def waves(planes):
        turns, phase = 3 * torch.rand(2, EXAMPLES, planes, 1, 1, generator=rng), 6 * torch.rand(EXAMPLES, planes, 1, 1, generator=rng)
        return torch.sin(6 * (turns[0] * x + turns[1] * y) + phase)

    slopes = 0.4 * waves(2)
    inlay = (x > 0.6).float()
    diffuse = (0.4 + 0.35 * waves(3)) * (1 - 0.9 * inlay)
    specular = 0.04 + inlay * (0.5 + 0.2 * waves(3))
    maps = join(diffuse, normal_from_slopes(slopes[:, :1], slopes[:, 1:]), 0.5 + 0.35 * waves(1), specular)
    geometry = camera.draw_geometry(rng, EXAMPLES, PHOTOS, HEIGHT, WIDTH, maps.device)
    inputs = camera.network_input(*camera.clean_photos(maps, geometry), geometry)
    views = draw_views(torch.Generator().manual_seed(SEED), EXAMPLES, SETTINGS["loss"]["views"])
    return {"inputs": inputs, "maps": maps, **dict(zip(("camera", "light", "intensity"), views))}


def trained(folder):
    """The steps of the trainer; its checkpoint goes to `folder`."""
    config = configuration.merged(configuration.DEFAULTS, SETTINGS)
    config["model"] = TRAINED
    trainer = Trainer(config, torch.device("cpu"))
    weights = random_weights(TRAINED, torch.Generator().manual_seed(SEED))
    trainer.model.double().load_state_dict({name: tensor.double() for name, tensor in weights.items()})
    trainer.average = {name: parameter.detach().clone() for name, parameter in trainer.named.items()}
    given = batch()
    out = {**given, **{f"start.{name}": tensor for name, tensor in weights.items()}}
    rates, measured = [], []
    for step in range(STEPS):
        rates.append(trainer.rate())
        rng = torch.Generator().manual_seed(SEED)
        measured.append(trainer.descend(given["inputs"].double(), given["maps"].double(), rng))
        if step == 0:
            out.update({f"gradient.{name}": parameter.grad.clone() for name, parameter in trainer.named.items()})
    out.update({f"measured.{name}": torch.tensor([float(of_step[name]) for of_step in measured], dtype=torch.float64) for name in measured[0]})
    out["rate"] = torch.tensor(rates, dtype=torch.float64)
    trainer.model.float()
    trainer.average = {name: tensor.float() for name, tensor in trainer.average.items()}
    for state in trainer.optimiser.state.values():
        state.update({key: tensor.float() for key, tensor in state.items()})
    trainer.save(folder)
    return out


def main(folder):
    default, training = folder / "default", folder / "training"
    default.mkdir(parents=True, exist_ok=True)
    weights, given = made_up()
    export.write(default / "weights.safetensors", weights, {"network": "photo graph", "model": CONFIG}, {"license": "CC0-1.0", "data": "random weights"}, torch.float32)
    store.save(default / "expected.safetensors", {**given, **answers(weights, given)})
    training.mkdir(parents=True, exist_ok=True)
    store.save(training / "steps.safetensors", trained(training))


if __name__ == "__main__":
    main(Path(sys.argv[1]))
