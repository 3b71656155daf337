#!/usr/bin/env python3
"""Damages captures, photos, materials and weights at random, and looks what becomes of them.

    mutations.py [--cases 5000] [--first 0] [--seed 1]

Every case must end within ten seconds, in memory that suits the files, with an error of the package or with results that are finite and in range. Photos that
OpenImageIO reads too must have its pixels, or a warning that they may be damaged. The same seed and number give the same case: `--first N --cases 1` runs one again. Prints what is
wrong, and how the cases ended; the exit code is 1 if anything is wrong.
"""

import argparse
import json
import math
import os
import random
import re
import resource
import select
import shutil
import subprocess
import sys
import tempfile
from collections import Counter
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
SECONDS = 10
# Of address space: libraries and threads take some 1 GiB of it, the files nothing that counts.
MEMORY = 4 << 30
KINDS = ("photo",) * 10 + ("capture",) * 4 + ("material",) * 4 + ("weights",) * 2
NUMBERS = ("0", "-1", "1e308", "-1e308", "1e-320", "1e999", "NaN", "Infinity", "null", '"1"', "[]", "{}", "true", "4294967296", "18446744073709551616", "0.1")
BYTES = (0, 1, 0x7F, 0x80, 0xFF)


def damaged(data, rng):
    """Bytes with one to eight places changed, cut, moved or doubled."""
    data = bytearray(data)
    for _ in range(rng.choice((1, 1, 1, 2, 3, 8))):
        if not data:
            break
        # Headers are short, and every byte of them counts.
        place = rng.randrange(len(data)) if rng.random() < 0.5 else rng.randrange(min(len(data), 512))
        length = rng.choice((1, 1, 2, 4, 8, 64))
        what = rng.randrange(7)
        if what == 0:
            data[place] ^= 1 << rng.randrange(8)
        elif what == 1:
            data[place] = rng.choice(BYTES)
        elif what == 2:
            data[place : place + length] = bytes(rng.choice(BYTES) for _ in range(length))
        elif what == 3:
            del data[place : place + length]
        elif what == 4:
            data[place:place] = rng.randbytes(length)
        elif what == 5:
            data[place:place] = data[max(0, place - length) : place]
        else:
            del data[place:]
    return bytes(data)


def damaged_text(text, rng):
    """Text of which numbers, words or bytes are others."""
    if rng.random() < 0.3:
        return damaged(text, rng)
    for _ in range(rng.choice((1, 1, 2, 4))):
        places = list(re.finditer(rb'-?\d[\d.e+-]*|"[^"]*"|[\[\]{},:]', text))
        if not places:
            break
        place = rng.choice(places)
        new = rng.choice(NUMBERS).encode() if rng.random() < 0.7 else rng.choice(places).group()
        text = text[: place.start()] + new + text[place.end() :]
    return text


class Wrong(Exception):
    """A result that must not be."""


def expect(condition, text):
    if not condition:
        raise Wrong(text)


def write(path, data):
    path.write_bytes(data)
    return path


class Cases:
    """What the cases begin with, and what is done with them; lives in the process that may die."""

    def __init__(self, folder):
        import numpy as np
        import OpenImageIO as oiio

        import svbrdf_gcn

        self.np, self.oiio, self.svbrdf_gcn = np, oiio, svbrdf_gcn
        self.folder = folder
        seeds = ROOT / "fuzz" / "seeds"
        self.photos = sorted((seeds / "image").iterdir())
        # The first byte of these files says which layout they have.
        self.captures = [(seeds / "folders" / name).read_bytes()[1:] for name in ("capture_json", "diff_renderer")]
        self.captures.append((ROOT / "samples" / "tiles" / "capture.json").read_bytes())
        self.networks = [path.read_bytes() for path in sorted((seeds / "weights").iterdir())]
        self.networks.append((ROOT / "core" / "weights" / "default.safetensors").read_bytes())
        self.materials = []
        rng = np.random.default_rng(1)
        normal = np.zeros((5, 6, 3)) + [0, 0, 1]
        for form in ("exr", "png16", "tiff"):
            material = svbrdf_gcn.Material(rng.random((5, 6, 3)), rng.random((5, 6, 3)), rng.random((5, 6, 1)), normal, patch_size=2.0)
            place = folder / f"material-{form}"
            material.save(place, format=form)
            self.materials.append(place)

    def run(self, number, seed):
        """How the case ended: a word."""
        rng = random.Random(f"{seed} {number}")
        kind = rng.choice(KINDS)
        place = self.folder / "case"
        shutil.rmtree(place, ignore_errors=True)
        place.mkdir()
        try:
            return f"{kind}: {getattr(self, kind)(place, rng)}"
        except (self.svbrdf_gcn.SvbrdfError, OSError, MemoryError) as error:
            expect(str(error) and "None" not in str(error), f"an error that says nothing: {error!r}")
            return f"{kind}: error"

    def photo(self, place, rng):
        source = rng.choice(self.photos)
        name = "photo" + source.suffix
        write(place / name, damaged(source.read_bytes(), rng))
        described = {
            "format": "svbrdf-gcn capture",
            "version": 1,
            "patch_size": 1,
            "transfer": "linear",
            "light_intensity": [10, 10, 10],
            "photos": [{"file": name, "camera": [0, 0, 2]}],
        }
        (place / "capture.json").write_text(json.dumps(described))
        capture = self.svbrdf_gcn.Capture.open(place, ignore_profiles=True)
        (photo,) = capture.photos
        expect(self.np.isfinite(photo).all(), "a photo that is not finite")
        if any("may be damaged" in warning for warning in capture.warnings):
            return "read, with a warning"
        return self.compare(place / name, photo)

    def compare(self, path, photo):
        """Against OpenImageIO, where it reads the same picture."""
        np, oiio = self.np, self.oiio
        keep = oiio.ImageSpec()
        # Colours as they are stored, not multiplied by alpha.
        keep.attribute("oiio:UnassociatedAlpha", 1)
        file = oiio.ImageInput.open(str(path), keep)
        if file is None:
            return "read, not by OpenImageIO"
        spec = file.spec()
        theirs = file.read_image("float")
        if theirs is None or file.has_error:
            return "read, not by OpenImageIO"
        same_window = (spec.x, spec.y, spec.width, spec.height) == (spec.full_x, spec.full_y, spec.full_width, spec.full_height)
        # Of a file with pages we take the full one, OpenImageIO the first.
        reduced = spec.get_int_attribute("tiff:subfiletype", 0) != 0
        if reduced or not same_window or spec.depth != 1 or spec.get_int_attribute("Orientation", 1) != 1 or not np.isfinite(theirs).all():
            return "read, another view of it"
        theirs = theirs.reshape(spec.height, spec.width, -1)
        names = [name.split(".")[-1].upper() for name in spec.channelnames]
        if {"R", "G", "B"} <= set(names):
            theirs = theirs[..., [names.index(name) for name in "RGB"]]
        elif spec.nchannels <= 2:
            theirs = np.repeat(theirs[..., :1], 3, -1)
        else:
            return "read, other channels"
        expect(theirs.shape == photo.shape, f"{photo.shape} where OpenImageIO has {theirs.shape}")
        off = np.abs(theirs - photo)
        if path.suffix == ".jpg":
            # Decoders may round and enlarge colours in their own ways.
            expect(off.mean() < 0.03, f"pixels off by {off.mean():.3f} in the mean")
        else:
            expect((off <= 1e-6 + 1e-6 * np.abs(theirs)).all(), f"pixels off by {off.max()}")
        return "as OpenImageIO"

    def capture(self, place, rng):
        for name in ("00.png", "1.png", "02.png"):
            shutil.copyfile(ROOT / "fuzz" / "seeds" / "image" / "rgb8.png", place / name)
        text = rng.choice(self.captures)
        if b"svbrdf-gcn capture" not in text:
            path = write(place / "other.json", damaged_text(text, rng))
        else:
            write(place / "capture.json", damaged_text(re.sub(rb"0[1-8]\.png", b"00.png", text), rng))
            path = place
        capture = self.svbrdf_gcn.Capture.open(path)
        expect(len(capture) > 0 and math.isfinite(capture.patch_size) and capture.patch_size > 0, "a capture without photos or size")
        expect(all(self.np.isfinite(photo).all() for photo in capture.photos), "a photo that is not finite")
        if len(capture) > 4 or rng.random() < 0.5:
            return "read"
        fitted = self.svbrdf_gcn.fit_material(capture, preset="draft", direct_steps=20, threads=1)
        self.in_range(fitted)
        return "fitted"

    def material(self, place, rng):
        source = rng.choice(self.materials)
        shutil.copytree(source, place, dirs_exist_ok=True)
        path = rng.choice(sorted(place.iterdir()))
        data = path.read_bytes()
        write(path, damaged_text(data, rng) if path.suffix == ".json" else damaged(data, rng))
        material = self.svbrdf_gcn.Material.load(place)
        self.in_range(material)
        picture = material.render(camera=(0, 0, 2), light=(0.5, 0, 2))
        expect(self.np.isfinite(picture).all() and (picture >= 0).all(), "a rendering that is not finite")
        return "read"

    def weights(self, place, rng):
        path = write(place / "weights.safetensors", damaged(rng.choice(self.networks), rng))
        photos = self.np.full((2, 4, 4, 3), 0.2, self.np.float32)
        capture = self.svbrdf_gcn.Capture(
            photos, camera_positions=[[0, 0, 2], [1, 0, 2]], patch_size=1, light_intensity=10, transfer="linear"
        )
        fitted = self.svbrdf_gcn.fit_material(
            capture, weights=path, preset="draft", latent_steps=1, adapter_steps=1, direct_steps=1, finish_steps=1, threads=1
        )
        self.in_range(fitted)
        return "fitted"

    def in_range(self, material):
        np = self.np
        for name in ("diffuse_albedo", "specular_albedo", "roughness"):
            values = getattr(material, name)
            expect(np.isfinite(values).all() and values.min() >= -1e-6 and values.max() <= 1 + 1e-6, f"{name} out of range")
        length = np.linalg.norm(material.normal, axis=-1)
        expect(np.isfinite(length).all() and (np.abs(length - 1) < 1e-2).all(), "normals that are not unit vectors")


def work(seed):
    """The process that may die: a case's number a line in, how it ended a line out."""
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    with tempfile.TemporaryDirectory() as folder:
        cases = Cases(Path(folder))
        print("ready", flush=True)
        for line in sys.stdin:
            try:
                ended = cases.run(int(line), seed)
            except Wrong as wrong:
                ended = f"WRONG {wrong}"
            except Exception as error:  # Anything else is no error that a user could understand.
                ended = f"WRONG {type(error).__name__}: {error}"
            print(ended.replace("\n", " "), flush=True)


class Worker:
    """A process for cases, begun anew where one has killed it."""

    def __init__(self, seed):
        self.command = [sys.executable, __file__, "--worker", "--seed", str(seed)]
        self.process = None

    def answer(self, seconds):
        ready, _, _ = select.select([self.process.stdout], [], [], seconds)
        return self.process.stdout.readline() if ready else None

    def run(self, number):
        if self.process is None:
            environment = {**os.environ, "OPENBLAS_NUM_THREADS": "1", "RAYON_NUM_THREADS": "1"}
            self.process = subprocess.Popen(
                self.command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True, env=environment
            )
            if self.answer(60) != "ready\n":
                raise RuntimeError("the process for the cases does not start; run with --worker to see why")
        self.process.stdin.write(f"{number}\n")
        self.process.stdin.flush()
        line = self.answer(SECONDS)
        if line:
            return line.strip()
        self.process.kill()
        code = self.close()
        return f"WRONG no end within {SECONDS} s" if line is None else f"WRONG the process died: {code}"

    def close(self):
        """Ends the process; its exit code."""
        if self.process is None:
            return None
        with self.process as process:
            self.process = None
            try:
                process.stdin.close()
            except BrokenPipeError:
                pass
        return process.returncode


def run(cases, first=0, seed=1):
    """How `cases` cases from number `first` on ended, and what is wrong: (number, text)."""
    worker, ends, wrong = Worker(seed), Counter(), []
    for number in range(first, first + cases):
        ended = worker.run(number)
        if ended.startswith("WRONG"):
            wrong.append((number, ended))
            print(f"case {number}: {ended}", flush=True)
        else:
            ends[ended] += 1
    worker.close()
    return ends, wrong


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cases", type=int, default=5000)
    parser.add_argument("--first", type=int, default=0, help="number of the first case")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--worker", action="store_true", help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.worker:
        work(arguments.seed)
        return
    ends, wrong = run(arguments.cases, arguments.first, arguments.seed)
    for ended, count in sorted(ends.items()):
        print(f"{count:6} {ended}")
    print(f"{len(wrong):6} wrong")
    sys.exit(1 if wrong else 0)


if __name__ == "__main__":
    main()
