"""Every public name has a documentation whose examples run, and the stubs say what the package has."""

import doctest
import functools
import inspect
import re
import subprocess
import sys
import threading
from pathlib import Path

import numpy as np
import pytest

import svbrdf_gcn
import svbrdf_gcn.training

ROOT = Path(__file__).resolve().parents[2]


def documented():
    """Modules, classes, functions and methods by name; properties and constants are part of their classes."""
    found = {"svbrdf_gcn": svbrdf_gcn}
    for module in (svbrdf_gcn, svbrdf_gcn.errors, svbrdf_gcn.metrics, svbrdf_gcn.training):
        found[module.__name__] = module
        for name in module.__all__:
            if callable(getattr(module, name)):
                found[f"{module.__name__}.{name}"] = getattr(module, name)
    for path, cls in list(found.items()):
        if inspect.isclass(cls):
            for name in vars(cls):
                if not name.startswith("_") and callable(getattr(cls, name)):
                    found[f"{path}.{name}"] = getattr(cls, name)
    return found


@pytest.mark.parametrize("name", documented())
def test_examples(name, monkeypatch):
    # The examples name files of the repository.
    monkeypatch.chdir(ROOT)
    subject = documented()[name]
    text = inspect.getdoc(subject)
    assert text
    test = doctest.DocTestParser().get_doctest(text, {"svbrdf_gcn": svbrdf_gcn}, name, None, None)
    is_exception = inspect.isclass(subject) and issubclass(subject, Exception)
    assert test.examples or is_exception or name in ("svbrdf_gcn.metrics", "svbrdf_gcn.training")
    said = []
    results = doctest.DocTestRunner().run(test, out=said.append)
    assert results.failed == 0, "".join(said)


def test_properties_are_documented():
    for cls in (svbrdf_gcn.Capture, svbrdf_gcn.Material, svbrdf_gcn.Model, svbrdf_gcn.Progress, svbrdf_gcn.CancelToken):
        for name, member in vars(cls).items():
            if inspect.isgetsetdescriptor(member) and not name.startswith("_"):
                assert inspect.getdoc(member), f"{cls.__name__}.{name}"


@pytest.mark.parametrize("page", ["README.md", "docs/python.md", "python/README.md"])
def test_pages(page, monkeypatch, tmp_path):
    """The code of a page runs from top to bottom; a few steps of a fit will do."""
    (tmp_path / "samples").symlink_to(ROOT / "samples")
    (tmp_path / "my-capture").symlink_to(ROOT / "samples" / "tiles")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(svbrdf_gcn, "fit_material", functools.partial(svbrdf_gcn.fit_material, direct_steps=5, finish_steps=0))
    capture = svbrdf_gcn.Capture.open("my-capture", size=32)
    names = {
        "threading": threading,
        "photos": np.stack(capture.photos),
        "cameras": capture.camera_positions,
        "lights": capture.light_positions,
    }
    blocks = re.findall(r"```python\n(.*?)```", (ROOT / page).read_text(), re.DOTALL)
    assert blocks
    for block in blocks:
        exec(compile(block, page, "exec"), names)
    assert Path("my-material/material.json").exists()


def test_stubs_agree_with_the_package():
    # The trainer needs PyTorch and has no stubs.
    modules = ["svbrdf_gcn._svbrdf_gcn", "svbrdf_gcn.errors", "svbrdf_gcn.metrics"]
    subprocess.run([sys.executable, "-m", "mypy.stubtest", *modules, "--concise"], check=True)


def test_the_types_are_those_of_the_documentation(tmp_path):
    program = tmp_path / "program.py"
    program.write_text("""
from pathlib import Path
import numpy as np
import svbrdf_gcn
from svbrdf_gcn import CancelToken, Capture, Material, Model, Progress, fit_material, metrics

def on_step(progress: Progress) -> None:
    print(progress.stage.upper(), progress.step / progress.steps)

photos = np.zeros((2, 4, 6, 3), np.uint8)
cameras = [[-3.0, 0.0, 20.0], [3.0, 0.0, 20.0]]
capture = Capture(list(photos), camera_positions=cameras, patch_size=10, light_intensity=1200, transfer="srgb", views=[0])
files = Capture([Path("a.png"), Path("b.png")], camera_positions=cameras, patch_size=10, light_intensity=(1, 2, 3), transfer="srgb")
material: Material = fit_material(capture, weights=Model.load("w"), progress=on_step, cancel=CancelToken(), seed=np.int64(7))
fit_material(photos, camera_positions=np.array(cameras), patch_size=10, light_intensity=1200, transfer="srgb", views=range(2))
error: float = metrics.photo_rmse(material.render([0, 0, 20], [0, 0, 20]), capture.photos[0] * np.float32(0.5))
tangent = material.tangent
if tangent is not None:
    print(tangent.shape)
print(material.diffuse_albedo.mean(), material.report["method"], material.warnings[0].upper())
""")
    subprocess.run([sys.executable, "-m", "mypy", "--strict", str(program)], check=True, cwd=tmp_path)
    program.write_text("import svbrdf_gcn\nsvbrdf_gcn.fit_material('x', progress=lambda: None)\n")
    wrong = subprocess.run([sys.executable, "-m", "mypy", str(program)], capture_output=True, text=True, cwd=tmp_path)
    assert wrong.returncode == 1 and '"progress"' in wrong.stdout
