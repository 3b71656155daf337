"""A library of made-up materials, and a tiny network to train on it."""

from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
NEEDED = "PyTorch is not installed: the trainer is not tested; pip install torch, see docs/training.md"

try:
    import torch
except ModuleNotFoundError:
    pass  # the tests say so and skip
else:
    torch.set_num_threads(1)

TINY = {
    "seed": 5,
    "steps": 6,
    "photos": [1, 1, 1],
    "log_steps": 1,
    "data": {"groups": 3, "per_group": 2, "refresh": 1, "size": 48, "procedural": 0.5},
    "phase": [{"share": 0.5, "size": 24, "batch": 4}, {"share": 0.5, "size": 32, "batch": 2}],
    "model": {"stem": 4, "node": 6, "width": 4, "blocks": [1, 1], "middle": 1, "tail": 6, "tail_blocks": 1},
    "validation": {"size": 32, "photos": [1, 2], "views": 3},
}


@pytest.fixture(scope="session")
def library(tmp_path_factory):
    """A folder of eight smooth materials, one of metal, as PNG files."""
    import numpy as np
    from PIL import Image

    folder = tmp_path_factory.mktemp("library")
    rng = np.random.default_rng(3)
    y, x = np.mgrid[0:64, 0:64] / 64
    for number in range(8):
        place = folder / f"maker__{'metal' if number == 0 else 'stone'}{number}"
        place.mkdir()
        phase = rng.uniform(0, 6, 4)
        waves = [np.sin(2 * np.pi * (rng.integers(1, 4) * x + rng.integers(1, 4) * y) + p) for p in phase]
        normal = np.stack([0.3 * waves[0], 0.3 * waves[1], np.ones_like(x)], -1)
        normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
        pictures = {
            "basecolor": np.stack([0.5 + 0.3 * wave for wave in waves[:3]], -1),
            "normal": normal / 2 + 0.5,
            "roughness": 0.5 + 0.2 * waves[3],
        }
        if number == 0:
            pictures["metallic"] = np.ones_like(x)
        for kind, values in pictures.items():
            Image.fromarray(np.rint(values * 255).astype(np.uint8)).save(place / f"{kind}.png")
    return folder


@pytest.fixture(scope="session")
def packed(library, tmp_path_factory):
    """A pack of that library at 48 pixels, two materials held out."""
    from svbrdf_gcn.training import pack

    path = tmp_path_factory.mktemp("pack") / "materials.zip"
    pack.main([str(library), "-o", str(path), "--size", "48", "--quality", "98", "--hold-out", "2"])
    return path


@pytest.fixture
def config_file(packed, tmp_path):
    """A configuration that trains a tiny network on that pack in six steps."""

    def text(table):
        plain = [f"{key} = {value}" for key, value in table.items() if not isinstance(value, (dict, list)) or key in ("photos", "blocks")]
        return "\n".join(plain) + "\n"

    path = tmp_path / "tiny.toml"
    parts = [text(TINY), "[data]\n" + text({**TINY["data"], "pack": f'"{packed}"'})]
    parts += ["[[phase]]\n" + text(phase) for phase in TINY["phase"]]
    parts += ["[model]\n" + text(TINY["model"]), "[validation]\n" + text(TINY["validation"])]
    path.write_text("\n".join(parts))
    return path
