"""Draws the log of a training as one picture: python -m svbrdf_gcn.training.plot FOLDER -o log.png. Needs Pillow."""

import argparse
import json
import math
from pathlib import Path

from PIL import Image, ImageDraw

WIDTH, HEIGHT, MARGIN = 480, 300, 44
COLORS = ("#1f5fa8", "#c4501b", "#2c8a3d", "#8a3d8a", "#8c7a00", "#008c8c")


def panel(draw, left, top, title, curves, logarithmic, last):
    """One diagram with `curves`: name -> points (x, y), x from 0 to `last`. Names have the last y beside them."""
    points = [point for curve in curves.values() for point in curve]
    if not points:
        return
    scale = math.log10 if logarithmic else float
    ys = [scale(max(y, 1e-9)) if logarithmic else y for _, y in points]
    low, high = min(ys), max(ys)
    # Single peaks of the first steps do not set the scale.
    if len(ys) > 50:
        high = sorted(ys)[int(0.995 * len(ys))]
    high = high if high > low else low + 1

    def place(x, y):
        y = scale(max(y, 1e-9)) if logarithmic else y
        across, up = x / last, min((y - low) / (high - low), 1)
        return left + MARGIN + across * (WIDTH - 1.5 * MARGIN), top + HEIGHT - MARGIN - up * (HEIGHT - 2 * MARGIN)

    box = [left + MARGIN, top + MARGIN, left + WIDTH - MARGIN / 2, top + HEIGHT - MARGIN]
    draw.rectangle(box, outline="#888888")
    for share in (0, 0.25, 0.5, 0.75, 1):
        value = low + share * (high - low)
        y = box[3] - share * (box[3] - box[1])
        draw.line([box[0] - 3, y, box[2], y], fill="#dddddd")
        draw.text((left + 2, y - 6), f"{10**value if logarithmic else value:.3g}", fill="#333333")
        draw.text((box[0] + share * (box[2] - box[0]) - 10, box[3] + 4), f"{share * last:.0f}", fill="#333333")
    draw.text((left + MARGIN, top + 2), title, fill="#000000")
    for number, (color, (name, curve)) in enumerate(zip(COLORS, curves.items())):
        label = left + MARGIN + number % 3 * (WIDTH - 1.5 * MARGIN) / 3, top + 15 + number // 3 * 13
        draw.text(label, f"{name}  {curve[-1][1]:.3g}", fill=color)
        line = [place(x, y) for x, y in curve]
        if len(line) > 1:
            draw.line(line, fill=color, width=2)
        else:
            draw.ellipse([line[0][0] - 2, line[0][1] - 2, line[0][0] + 2, line[0][1] + 2], fill=color)


def main(arguments=None):
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("-o", "--output", required=True)
    options = parser.parse_args(arguments)
    entries = [json.loads(line) for line in (options.folder / "log.jsonl").read_text().splitlines()]
    steps = [entry for entry in entries if "loss" in entry]
    checks = [entry for entry in entries if "validation" in entry]
    if not steps:
        raise SystemExit(f"{options.folder / 'log.jsonl'}: no steps yet")

    def measured(*names):
        return {name: [(entry["step"], entry[name]) for entry in steps] for name in names}

    def validated(key):
        names = checks[-1]["validation"] if checks else {}
        return {name: [(entry["step"], entry["validation"][name][key]) for entry in checks if name in entry["validation"]] for name in names}

    last = max(entries[-1]["step"], 1)
    panels = [
        ("training loss", measured("loss"), True),
        ("maps and rendering (L1)", measured("maps", "rendering"), True),
        ("maps, encoded (L1)", measured("diffuse", "normal", "roughness", "specular"), True),
        ("validation: re-rendering RMSE by captures and photos", validated("rendering"), False),
        ("validation: RMSE of roughness", validated("R"), False),
        ("validation: mean normal angle, degrees", validated("N_deg"), False),
        ("certainty (log likelihood)", measured("certainty"), False),
        ("gradient norm", measured("norm"), True),
        ("learning rate", measured("rate"), True),
    ]
    picture = Image.new("RGB", (3 * WIDTH, 3 * HEIGHT), "white")
    draw = ImageDraw.Draw(picture)
    for number, (title, curves, logarithmic) in enumerate(panels):
        panel(draw, number % 3 * WIDTH, number // 3 * HEIGHT, title, curves, logarithmic, last)
    picture.save(options.output)


if __name__ == "__main__":
    main()
