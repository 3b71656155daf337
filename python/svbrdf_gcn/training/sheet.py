"""Pictures of what the trainer samples and the network predicts, for a person to judge.

    python -m svbrdf_gcn.training.sheet training CONFIG -o sheet.png [--rows 6] [--photos 4] [--step 0]   sampled materials and their photos
    python -m svbrdf_gcn.training.sheet kinds -o sheet.png [--size 128]                                  four procedural materials of every kind
    python -m svbrdf_gcn.training.sheet validation CONFIG --run FOLDER -o sheet.png [--photos 4]         prediction (upper) and truth (lower row) of held-out materials

Columns: diffuse, normal, roughness, specular, a rendering lit from the left, one lit from above, then photos; for predictions also
three times the standard deviations of diffuse (mean), normal (mean), roughness.
"""

import argparse

import numpy as np
import torch
from PIL import Image

from . import TrainingData, configuration
from .data import open_data, tensors
from .maps import DIFFUSE, GAMMA, NORMAL, ROUGHNESS, SPECULAR, decode_maps
from .render import encode_radiance, pixel_positions, render
from .train import Trainer


def lit(maps, direction):
    """A rendering under a light in `direction`, camera above."""
    count = len(maps)
    place = torch.tensor(direction, dtype=torch.float32, device=maps.device).expand(count, 1, 3)
    eye = torch.tensor([0.0, 0.0, 4.0], device=maps.device).expand(count, 1, 3)
    intensity = torch.full((count, 1, 3), 3.0 * float((place[0, 0] ** 2).sum()), device=maps.device)
    position = pixel_positions(*maps.shape[-2:], device=maps.device)[None]
    return encode_radiance(render(maps, position, eye, place, intensity))[:, 0].clamp(0, 1)


def pictures(maps):
    """Pictures (B, K, 3, H, W) of maps."""
    three = (-1, 3, -1, -1)
    parts = [
        maps[:, DIFFUSE] ** (1 / GAMMA),
        maps[:, NORMAL] / 2 + 0.5,
        maps[:, ROUGHNESS].expand(three),
        maps[:, SPECULAR] ** (1 / GAMMA),
        lit(maps, [-2.5, 0.0, 2.0]),
        lit(maps, [0.0, 2.5, 2.0]),
    ]
    return torch.stack(parts, 1)


def write(path, rows):
    """`rows` (R, K, 3, H, W) as one picture with gaps."""
    rows = torch.nn.functional.pad(rows.detach().cpu().clamp(0, 1), (2, 2, 2, 2), value=0.5)
    picture = torch.cat([torch.cat(list(row), -1) for row in rows], -2)
    Image.fromarray((picture.permute(1, 2, 0).numpy() * 255).round().astype(np.uint8)).save(path)


def main(arguments=None):
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=["training", "kinds", "validation"])
    parser.add_argument("config", nargs="?")
    parser.add_argument("-o", "--output", required=True)
    parser.add_argument("--run", help="folder of a training, whose averaged weights predict")
    parser.add_argument("--rows", type=int, default=6)
    parser.add_argument("--photos", type=int, default=4)
    parser.add_argument("--step", type=int, default=0)
    parser.add_argument("--size", type=int)
    parser.add_argument("--family", choices=["near", "real"], default="real")
    parser.add_argument("--device", default="cuda" if torch.cuda.is_available() else "cpu")
    options = parser.parse_args(arguments)
    device = torch.device(options.device)
    if options.what == "kinds":
        kinds, size = TrainingData.KINDS, options.size or 128
        numbers = [[kind + kinds * (options.step + turn) for turn in range(4)] for kind in range(kinds)]
        rows = []
        for row in numbers:
            maps = torch.stack([torch.from_numpy(TrainingData.procedural(1, number, size)) for number in row]).to(device)
            rows.append(torch.cat(list(pictures(maps)[:, [0, 1, 2, 4]])))
        return write(options.output, torch.stack(rows))
    config = configuration.load(options.config)
    config["photos"] = [float(number == options.photos) for number in range(1, options.photos + 1)]
    data = open_data(config)
    with torch.no_grad():
        if options.what == "training":
            batch = tensors(data.batch(options.step, options.rows, options.size or config["phase"][0]["size"]), device)
            return write(options.output, torch.cat([pictures(batch["maps"]), batch["inputs"][:, :, :3]], 1))
        trainer = Trainer(config, device)
        trainer.load(options.run)
        model, rows = trainer.averaged().eval(), []
        size = options.size or config["validation"]["size"]
        for number in range(min(options.rows, len(data.held_out))):
            batch = tensors(data.validation(options.family, options.photos, size, number, 1, 1), device)
            raw, log_sigma = model(batch["inputs"])
            sigma = 3 * torch.exp(log_sigma)
            sure = [sigma[:, :3].mean(1, keepdim=True), sigma[:, 3:5].mean(1, keepdim=True), sigma[:, 5:6]]
            sure = torch.stack([part.expand(-1, 3, -1, -1) for part in sure], 1)
            predicted = pictures(decode_maps(raw, model.config["roughness_floor"]))
            truth = pictures(batch["maps"])
            photos = batch["inputs"][:, :3, :3]
            if photos.shape[1] < 3:
                photos = torch.cat([photos, torch.zeros_like(photos[:, :1]).expand(-1, 3 - photos.shape[1], -1, -1, -1)], 1)
            rows += [torch.cat([predicted, sure], 1), torch.cat([truth, photos], 1)]
        write(options.output, torch.cat(rows))


if __name__ == "__main__":
    main()
