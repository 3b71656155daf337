"""What networks are trained on, without PyTorch: shapes, the same numbers for the same step, threads, errors."""

import json
import subprocess
import sys
import threading
import zipfile
from pathlib import Path

import numpy as np
import pytest

from svbrdf_gcn import ArgumentError, FormatError, SvbrdfError
from svbrdf_gcn.training import TrainingData

ROOT = Path(__file__).resolve().parents[2]
JPEG = (ROOT / "fuzz" / "seeds" / "image" / "grey8.jpg").read_bytes()
SETTINGS = {"seed": 1, "photos": [0, 1, 1], "procedural": 0.5, "groups": 3, "per_group": 2, "refresh": 1, "size": 32, "captures": "any", "directions": True, "views": 3}


@pytest.fixture(scope="module")
def pack(tmp_path_factory):
    """A pack of three grey materials of 9 x 9 pixels, one held out."""
    path = tmp_path_factory.mktemp("pack") / "materials.zip"
    names = ("a", "b", "c")
    with zipfile.ZipFile(path, "w") as archive:
        for name in names:
            for kind in ("basecolor", "normal", "roughness"):
                archive.writestr(f"{name}/{kind}.jpg", JPEG)
        entries = [{"name": name, "metallic": False, "validation": name == "b", "licence": "CC0-1.0"} for name in names]
        archive.writestr("materials.json", json.dumps({"size": 9, "materials": entries}))
    return path


def opened(pack, **changes):
    return TrainingData(pack, **{**SETTINGS, **changes})


def test_a_batch(pack):
    data = opened(pack)
    assert (data.materials, data.held_out) == (2, ["b"])
    assert data.facts == {"materials": 2, "licences": {"CC0-1.0": 2}, "held_out": ["b"], "procedural": "core/src/train/procedural.rs"}
    batch = data.batch(4, count=3, size=16)
    photos = batch["inputs"].shape[1]
    shapes = {"inputs": (3, photos, 13, 16, 16), "maps": (3, 10, 16, 16), "shots": (3, photos, 3, 3), "views": (3, 3, 3, 3)}
    assert photos in (2, 3) and {name: array.shape for name, array in batch.items()} == shapes
    for array in batch.values():
        assert array.dtype == np.float32 and array.flags.c_contiguous and np.isfinite(array).all()


def test_the_same_step_gives_the_same_numbers(pack):
    first, second = opened(pack, threads=1), opened(pack, threads=2)
    second.batch(9, 2, 16)
    for step in (0, 5, 2):
        a, b = first.batch(step, 2, 16), second.batch(step, 2, 16)
        assert all((a[name] == b[name]).all() for name in a)
    other = opened(pack, seed=2).batch(2, 2, 16)
    assert (other["maps"] != a["maps"]).any()
    near, again = (first.validation("near", photos=2, size=16, first=0, count=1, views=4) for _ in range(2))
    assert all((near[name] == again[name]).all() for name in near) and near["views"].shape == (1, 4, 3, 3)


def test_arrays_are_the_caller_s_own(pack):
    data = opened(pack)
    batch = data.batch(0, 2, 16)
    kept, before = batch["maps"], batch["maps"].copy()
    batch["inputs"][:] = 0
    del data, batch
    assert (kept == before).all()
    kept[:] = 1


def test_other_threads_run_meanwhile_and_all_may_ask(pack):
    data, batches = opened(pack), {}

    def draw(step):
        batches[step] = data.batch(step, 8, 64)

    threads = [threading.Thread(target=draw, args=(step,)) for step in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    alone = opened(pack)
    assert all((batches[step]["inputs"] == alone.batch(step, 8, 64)["inputs"]).all() for step in range(4))


def test_procedural_materials():
    assert TrainingData.KINDS == 14
    for kind in range(TrainingData.KINDS):
        maps = TrainingData.procedural(3, kind, 24)
        assert maps.shape == (10, 24, 24) and np.abs(np.square(maps[3:6]).sum(0) - 1).max() < 1e-3
        assert (maps == TrainingData.procedural(3, kind, 24)).all() and (maps != TrainingData.procedural(4, kind, 24)).any()


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"procedural": 1.5}, "procedural: expected 0 to 1, got 1.5"),
        ({"photos": [0, 0]}, "photos: expected weights"),
        ({"groups": -1}, "groups: expected an integer of 0 or more, got -1"),
        ({"size": 5000}, "size: expected 8 to 4096, got 5000"),
        ({"captures": "some"}, "captures: expected any, near, real or paper, got 'some'"),
        ({"threads": 0}, "threads: expected 1 to 1024, got 0"),
    ],
)
def test_wrong_settings_are_named(pack, changes, message):
    with pytest.raises(ArgumentError, match=f"^{message}"):
        opened(pack, **changes)


def test_wrong_arguments_are_named(pack, tmp_path):
    with pytest.raises(FormatError, match="photos: expected numbers, got 'abc'"):
        opened(pack, photos="abc")
    with pytest.raises(FileNotFoundError, match="nowhere"):
        opened(tmp_path / "nowhere.zip")
    (tmp_path / "broken.zip").write_bytes(b"no zip")
    with pytest.raises(SvbrdfError, match=r"broken\.zip"):
        opened(tmp_path / "broken.zip")
    data = opened(pack)
    with pytest.raises(ArgumentError, match="size: expected 8 to 4096, got 4"):
        data.batch(0, 2, 4)
    with pytest.raises(ArgumentError, match="step"):
        data.batch(-1, 2, 16)
    with pytest.raises(ArgumentError, match="materials: expected some of the 1 held out, got 1..2"):
        data.validation("near", 1, 16, 1, 1, 2)
    with pytest.raises(MemoryError):
        data.batch(0, 4096, 4096)


def test_the_trainer_says_what_it_needs(tmp_path):
    """Without PyTorch, which is not among what these tests install; from the package, which knows its Python, and from the module."""
    without = "import sys; sys.modules['torch'] = None; sys.argv[1:] = ['x', '-o', 'y']; import importlib.util as u; find = u.find_spec; "
    without += "u.find_spec = lambda name: None if name == 'torch' else find(name); import runpy; runpy.run_module('svbrdf_gcn.training', run_name='__main__')"
    done = subprocess.run([sys.executable, "-c", without], capture_output=True, text=True, cwd=tmp_path)
    assert done.returncode == 1 and "torch" in done.stderr and "pip install 'svbrdf-gcn[training]'" in done.stderr
    command = [sys.executable, "-m", "svbrdf_gcn", "train", "--python", str(tmp_path / "nowhere"), "x", "-o", "y"]
    done = subprocess.run(command, capture_output=True, text=True, cwd=tmp_path)
    assert done.returncode == 2 and "nowhere" in done.stderr and "pip install 'svbrdf-gcn[training]'" in done.stderr
