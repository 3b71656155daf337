#!/usr/bin/env python3
"""Fits the same capture from several languages and compares what they write, byte for byte.

    compare.py OUT NAME=COMMAND NAME=COMMAND ...

Each COMMAND is called as `COMMAND CAPTURE FOLDER FORMAT` and has to fit the capture with: size 48, views 6, 0, 2, 4, preset draft, seed 7, 2 threads,
and to save the maps to FOLDER as FORMAT (exr, png16 or tiff). The first is the reference; `cli` alone stands for the command line, whose program it names.
material.json has to be the same but for the times in it. Maps that come from Blender's images know nothing of their fit: of `blender`, material.json is not
compared. Normals are kept there as (n + 1) / 2 in single precision: in png16 and tiff they may differ by that rounding, which at times is a code of 16 bits. The maps depend on the CPU, so nothing is compared with files from another machine.
"""

import json
import pathlib
import shlex
import subprocess
import sys

CAPTURE = pathlib.Path(__file__).resolve().parents[2] / "samples" / "tiles"
FORMATS = {"exr": "exr", "png16": "png", "tiff": "tif"}
MAPS = ["diffuse", "specular", "roughness", "normal"]
# How far normals out of Blender may be off, by file: a code of 16 bits, and the rounding of numbers near 1.
NORMALS_OFF = {"png": 1.05 * 2 / 65535, "tif": 2.5e-7}
OPTIONS = ["--size", "48", "--views", "6,0,2,4", "--preset", "draft", "--seed", "7", "--threads", "2"]


def run(name, command, folder, image_format):
    if name == "cli":
        arguments = [*command, "fit", str(CAPTURE), "-o", str(folder), *OPTIONS, "--format", image_format, "--quiet"]
    else:
        arguments = [*command, str(CAPTURE), str(folder), image_format]
    subprocess.run(arguments, check=True)


def without_times(value):
    if isinstance(value, dict):
        return {key: without_times(item) for key, item in value.items() if key != "seconds"}
    if isinstance(value, list):
        return [without_times(item) for item in value]
    return value


def same_normals(reference, other, tolerance):
    """Whether the normals of two folders agree."""
    # Only Blender's normals need them: the comparison of C and C++ runs without.
    import numpy as np
    import svbrdf_gcn

    ours, theirs = (np.asarray(svbrdf_gcn.Material.load(folder).normal) for folder in (reference, other))
    return ours.shape == theirs.shape and float(np.abs(ours - theirs).max()) <= tolerance


def differences(reference, other, extension, from_blender):
    """Names of the files that differ."""
    different = []
    for name in MAPS:
        file = f"{name}.{extension}"
        if from_blender and name == "normal" and extension in NORMALS_OFF:
            same = same_normals(reference, other, NORMALS_OFF[extension])
        else:
            same = (reference / file).read_bytes() == (other / file).read_bytes()
        if not same:
            different.append(file)
    descriptions = [json.loads((folder / "material.json").read_text()) for folder in (reference, other)]
    if not from_blender and without_times(descriptions[0]) != without_times(descriptions[1]):
        different.append("material.json")
    return different


def main(out, *languages):
    commands = dict(language.split("=", 1) for language in languages)
    failed = 0
    for image_format, extension in FORMATS.items():
        folders = {}
        for name, command in commands.items():
            folders[name] = pathlib.Path(out) / f"{name}-{image_format}"
            run(name, shlex.split(command), folders[name], image_format)
        reference, *others = folders
        for name in others:
            different = differences(folders[reference], folders[name], extension, name == "blender")
            failed += bool(different)
            print(f"{image_format}: {name} and {reference}: {', '.join(different) + ' differ' if different else 'the same'}")
    return min(failed, 1)


if __name__ == "__main__":
    if len(sys.argv) < 4:
        sys.exit(__doc__)
    sys.exit(main(*sys.argv[1:]))
