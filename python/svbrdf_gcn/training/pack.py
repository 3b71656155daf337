"""Packs a library of material maps into one file for the trainer.

    python -m svbrdf_gcn.training.pack LIBRARY... -o data/materials.zip [--size 320] [--quality 90] [--validation LIST | --hold-out 24]

A library is a folder of material folders; each holds `basecolor`, `normal` (+y up) and `roughness`, and `metallic` where the material
has metal, as PNG or JPEG. `MANIFEST.tsv` beside them, if there is one, gives `source_repo` and `licence`, which travel into the pack.
The pack is a zip archive of JPEG files and `materials.json`. Needs Pillow and numpy.

Validation materials are named by LIST, or chosen by a fixed rule: every material has a family, found by words in its name; families
give in proportion to their size (largest remainders), each those first in the order of the SHA-256 of their names; a material
whose base colour or normal map has a near twin elsewhere in the library is passed over.
"""

import argparse
import csv
import hashlib
import io
import json
import sys
import zipfile
from pathlib import Path

import numpy as np
from PIL import Image

MAPS = ("basecolor", "normal", "roughness", "metallic")
SUFFIXES = (".png", ".jpg", ".jpeg")
FAMILIES = {
    "metal": ("metal", "steel", "rust", "plate", "antislip"),
    "wood": ("wood", "plank", "oak", "walnut", "pine", "parquet", "bamboo", "bark", "birch", "ash", "herringbone", "veneer", "willow", "thatch"),
    "fabric": ("fabric", "linen", "carpet", "weave", "woven", "leather", "tatami", "wicker", "rattan", "wallpaper", "sponge", "vinyl"),
    "tiles": ("tile", "brick", "paving", "mosaic", "subway", "checker", "roof", "cobble"),
    "stone": ("marble", "travertine", "granite", "onyx", "terrazzo", "stone", "rock", "cliff", "carrara"),
    "plaster": ("concrete", "plaster", "wall", "paint", "lacquer", "polished", "clay", "textured", "subtle"),
    "ground": (),  # all others
}
# Correlation of two thumbnails from which on they are twins.
TWIN = 0.9


def family(name):
    word = name.split("__")[-1].lower()
    return next(family for family, words in FAMILIES.items() if not words or any(part in word for part in words))


def find(folder, kind):
    return next((path for suffix in SUFFIXES if (path := folder / (kind + suffix)).is_file()), None)


def resized(path, size, mode):
    with Image.open(path) as image:
        image = image.convert(mode)
    side = min(image.size)
    left, top = (image.width - side) // 2, (image.height - side) // 2
    return np.asarray(image.resize((size, size), Image.LANCZOS, box=(left, top, left + side, top + side)))


def encoded(pixels, quality):
    out = io.BytesIO()
    Image.fromarray(pixels).save(out, "JPEG", quality=quality, subsampling=0)
    return out.getvalue()


def unit_normals(pixels):
    normal = pixels.astype(np.float32) / 127.5 - 1
    normal /= np.maximum(np.linalg.norm(normal, axis=-1, keepdims=True), 1e-6)
    return np.rint((normal + 1) * 127.5).astype(np.uint8)


def thumbnails(images):
    """Base colour and normal at 16 x 16, each centred and of length 1."""
    prints = []
    for pixels in (images["basecolor"], images["normal"]):
        small = np.asarray(Image.fromarray(pixels).resize((16, 16), Image.BOX), np.float32)
        small = small - small.mean((0, 1))
        prints.append((small / max(np.linalg.norm(small), 1e-6)).ravel())
    return prints


def choose(prints, count):
    """Names of `count` validation materials by the rule above; `prints` maps every name to its thumbnails."""
    names = sorted(prints)
    free = set(names)
    for kind in range(2):
        matrix = np.stack([prints[name][kind] for name in names])
        twins = matrix @ matrix.T - 2 * np.eye(len(names)) > TWIN
        free -= {name for name, row in zip(names, twins) if row.any()}
    members = {}
    for name in names:
        members.setdefault(family(name), []).append(name)
    shares = {key: count * len(group) / len(names) for key, group in members.items()}
    seats = {key: int(share) for key, share in shares.items()}
    for key in sorted(shares, key=lambda key: (int(shares[key]) - shares[key], key))[: count - sum(seats.values())]:
        seats[key] += 1
    chosen = []
    for key, group in members.items():
        order = sorted((name for name in group if name in free), key=lambda name: hashlib.sha256(name.encode()).digest())
        chosen += order[: seats[key]]
    return sorted(chosen)


def manifest(library):
    path = library / "MANIFEST.tsv"
    if not path.is_file():
        return {}
    with open(path, encoding="utf-8", newline="") as file:
        return {row["name"]: row for row in csv.DictReader(file, delimiter="\t")}


def main(arguments=None):
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("library", nargs="+", type=Path)
    parser.add_argument("-o", "--output", type=Path, required=True)
    parser.add_argument("--size", type=int, default=320, help="pixels of a side")
    parser.add_argument("--quality", type=int, default=90, help="of the JPEG files, up to 100")
    parser.add_argument("--validation", type=Path, help="file with the names to hold out, one a line")
    parser.add_argument("--hold-out", type=int, default=24, help="how many to hold out by the rule, without --validation")
    options = parser.parse_args(arguments)

    entries, prints = {}, {}
    options.output.parent.mkdir(parents=True, exist_ok=True)
    with zipfile.ZipFile(options.output, "w", zipfile.ZIP_STORED) as archive:
        for library in options.library:
            facts = manifest(library)
            for folder in sorted(path for path in library.iterdir() if path.is_dir()):
                files = {kind: find(folder, kind) for kind in MAPS}
                missing = [kind for kind in MAPS[:3] if files[kind] is None]
                if missing:
                    print(f"{folder}: no {', '.join(missing)}: left out", file=sys.stderr)
                    continue
                if folder.name in entries:
                    raise SystemExit(f"{folder}: there are two materials of this name")
                images = {kind: resized(path, options.size, "RGB" if kind in MAPS[:2] else "L") for kind, path in files.items() if path}
                images["normal"] = unit_normals(images["normal"])
                for kind, pixels in images.items():
                    archive.writestr(f"{folder.name}/{kind}.jpg", encoded(pixels, options.quality))
                row = facts.get(folder.name, {})
                entries[folder.name] = {"name": folder.name, "family": family(folder.name), "metallic": "metallic" in images}
                entries[folder.name].update({key: row[key] for key in ("source_repo", "licence") if key in row})
                prints[folder.name] = thumbnails(images)
        if not entries:
            raise SystemExit(f"{options.library[0]}: no material folders")
        if options.validation:
            held = options.validation.read_text().split()
            unknown = [name for name in held if name not in entries]
            if unknown:
                raise SystemExit(f"{options.validation}: not in the library: {', '.join(unknown)}")
        else:
            held = choose(prints, min(options.hold_out, len(entries) - 1))
        for name in held:
            entries[name]["validation"] = True
        archive.writestr("materials.json", json.dumps({"size": options.size, "materials": list(entries.values())}, indent=1))
    print("\n".join(held))
    print(f"{len(entries)} materials, {len(held)} held out, {options.output.stat().st_size / 2**20:.1f} MiB", file=sys.stderr)


if __name__ == "__main__":
    main()
