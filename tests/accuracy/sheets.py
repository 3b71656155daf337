"""Pictures of maps and renderings side by side, for a person to judge."""

import numpy as np
from PIL import Image, ImageDraw, ImageFont

import scenes
from shading import gamma22, render

TILE, GAP, TEXT = 96, 2, 15
# The test position of the re-rendering that is shown.
SHOWN = 3
COLUMNS = ("D", "N", "R", "S", "Ren.")


def bytes_of(values, tile=TILE):
    """Display-encoded values (H, W, C) as an RGB picture `tile` high."""
    picture = Image.fromarray(np.rint(np.clip(scenes.colour(values), 0, 1) * 255).astype(np.uint8))
    return picture.resize((tile, tile), Image.Resampling.BOX)


def row_of(maps, shot, patch_size):
    """Maps and a re-rendering as pictures; colours in gamma 2.2, roughness and normals as they are."""
    radiance = render(maps, shot.camera, shot.light, shot.intensity, patch_size)
    return [bytes_of(v) for v in (gamma22(maps.diffuse), maps.normal / 2 + 0.5, maps.mean_roughness, gamma22(maps.specular), gamma22(radiance))]


def write(path, heads, rows):
    """A sheet: `heads` over groups of columns, then `rows` of (name, pictures)."""
    font = ImageFont.load_default(12)
    columns = len(rows[0][1])
    sheet = Image.new("RGB", (columns * (TILE + GAP) + GAP, TEXT + len(rows) * (TILE + TEXT + GAP)), "white")
    draw = ImageDraw.Draw(sheet)
    for number, head in enumerate(heads):
        draw.text((GAP + number * (TILE + GAP), 1), head, "black", font)
    for number, (name, pictures) in enumerate(rows):
        top = TEXT + number * (TILE + TEXT + GAP)
        draw.text((GAP, top), name, "black", font)
        for column, picture in enumerate(pictures):
            sheet.paste(picture, (GAP + column * (TILE + GAP), top + TEXT))
    path.parent.mkdir(parents=True, exist_ok=True)
    sheet.save(path, quality=82, optimize=True)


def synthetic(path, store, variant, kind, names, photos):
    """Truth and fit of each material."""
    rows = []
    for name in names:
        true = scenes.truth(kind, name)
        place = scenes.positions()[1][SHOWN]
        shot = scenes.Shot(place, place, scenes.INTENSITY, None)
        fitted, patch_size = scenes.load_fit(store.place(variant, kind, name, photos)[0])
        rows.append((name.split("__")[-1], row_of(true, shot, scenes.PATCH_SIZE) + row_of(fitted, shot, patch_size)))
    write(path, [f"{side} {column}" for side in ("true", "fitted") for column in COLUMNS], rows)


def real(path, store, variant, names):
    """Maps of each capture and the photos that were kept out, beside their re-renderings."""
    rows = []
    for name in names:
        fitted, patch_size = scenes.load_fit(store.place(variant, "real", name, len(scenes.PHOTOS_IN))[0])
        shots = scenes.real_tests(name)
        pictures = row_of(fitted, shots[0], patch_size)[:4]
        for shot in shots:
            pictures += [bytes_of(gamma22(shot.radiance)), row_of(fitted, shot, patch_size)[-1]]
        rows.append((name, pictures))
    heads = [f"fitted {column}" for column in COLUMNS[:4]]
    write(path, heads + [f"{what} {view}" for view in scenes.HELD_OUT for what in ("photo", "rendered")], rows)
