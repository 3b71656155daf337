"""Runs `svbrdf-gcn fit`, and keeps what was fitted and measured for the next time."""

import hashlib
import json
import shutil
import subprocess
import sys
import tempfile
from functools import lru_cache
from pathlib import Path

import scenes
from metrics import Views, map_errors

HERE = Path(__file__).resolve().parent


@lru_cache(maxsize=8)
def digest(*paths):
    """SHA-256 over the contents of files."""
    return hashlib.sha256(b"".join(hashlib.sha256(Path(path).read_bytes()).digest() for path in paths)).hexdigest()


def run(command):
    """Runs a program: what it printed, the processor seconds it used, and its peak memory in bytes."""
    with tempfile.NamedTemporaryFile("r") as used:
        launcher = [sys.executable, "-I", "-S", HERE / "usage.py", used.name]
        done = subprocess.run([*launcher, *command], capture_output=True, text=True, check=True)
        usage = json.load(used)
    if usage["code"] != 0:
        raise RuntimeError(f"{' '.join(map(str, command))}: exit code {usage['code']}: {done.stderr.strip()}")
    return done.stdout, usage["processor"], usage["memory"]


class Store:
    """Fits and measurements under a folder; `binary` is the command line."""

    def __init__(self, folder, binary):
        self.folder, self.binary = folder, binary

    def captures(self, kind, name):
        """The folder of the photos of a material, made if need be."""
        if kind == "real":
            return scenes.capture_folder(name)
        folder = self.folder / "captures" / kind / name
        made_by = digest(HERE / "scenes.py", HERE / "shading.py")
        mark = folder / "made-by"
        if not mark.exists() or mark.read_text() != made_by:
            scenes.write_capture(folder, scenes.truth(kind, name))
            mark.write_text(made_by)
        return folder

    def place(self, variant, kind, name, photos):
        """The folder of the maps of a fit, and the file of its figures."""
        folder = self.folder / "fits" / variant.name / kind / f"{name}-{photos}"
        return folder, folder.with_suffix(".json")

    def fit(self, variant, kind, name, photos):
        """Fits, unless the same program has already done so with the same arguments; returns the figures."""
        maps, file = self.place(variant, kind, name, photos)
        capture = self.captures(kind, name)
        views = scenes.PHOTOS_IN if kind == "real" else range(photos)
        arguments = ["--views", ",".join(map(str, views)), "--size", str(scenes.SIZE), *variant.arguments]
        key = [digest(self.binary), *arguments, digest(*sorted(capture.glob("*.png")), *sorted(capture.glob("*.txt")))]
        if file.exists():
            kept = json.loads(file.read_text())
            if kept["key"] == key:
                return kept
        file.unlink(missing_ok=True)
        shutil.rmtree(maps, ignore_errors=True)
        maps.parent.mkdir(parents=True, exist_ok=True)
        printed, processor, memory = run([self.binary, "fit", capture, "-o", maps, "--format", "tiff", "--json", *arguments])
        report = json.loads(printed)["report"]
        figures = {"key": key, "report": report, "seconds": report["seconds"], "processor": processor, "memory": memory}
        file.write_text(json.dumps(figures))
        return figures

    def measure(self, kind, name, fits):
        """Adds the errors to the figures of the fits (variant, photos) of one material, where they are not there yet."""
        measured_by = digest(*(HERE / source for source in ("scenes.py", "shading.py", "metrics.py", "lpips_alex.py")))
        truth, views = None, None
        for variant, photos in fits:
            maps, file = self.place(variant, kind, name, photos)
            figures = json.loads(file.read_text())
            if figures.get("measured_by") == [measured_by, *figures["key"]]:
                continue
            if views is None:
                truth = None if kind == "real" else scenes.truth(kind, name)
                views = Views(scenes.real_tests(name) if truth is None else scenes.synthetic_tests(truth))
            fitted, patch_size = scenes.load_fit(maps)
            errors = views.errors(fitted, patch_size)
            if truth is not None:
                errors |= map_errors(fitted, truth)
            file.write_text(json.dumps(figures | {"measured_by": [measured_by, *figures["key"]], "errors": errors}))

    def kept(self, variant, kind, name, photos):
        """The figures of an earlier run, or None."""
        file = self.place(variant, kind, name, photos)[1]
        figures = json.loads(file.read_text()) if file.exists() else {}
        return figures if "errors" in figures else None

