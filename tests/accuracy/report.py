"""Writes accuracy.md, its plots and its pictures."""

import math
import os
import statistics
from pathlib import Path

import plots
import scenes
import sheets
from metrics import covered
from variants import BASELINE, HEADLINE

REAL_PHOTOS = len(scenes.PHOTOS_IN)
# RMSE over 300 unseen synthetic materials as published by Luo et al. 2024: photos, method, D, N, R, S, re-rendering, LPIPS.
PUBLISHED = [
    (1, "DeepBasis", 0.041, 0.055, 0.088, 0.063, 0.066, 0.162),
    (1, "Luo et al.", 0.030, 0.034, 0.082, 0.045, 0.055, 0.145),
    (4, "Deep Inverse Rendering", 0.063, 0.028, 0.113, 0.062, 0.069, 0.162),
    (4, "MaterialGAN", 0.055, 0.032, 0.078, 0.057, 0.062, 0.150),
    (4, "Luo et al.", 0.024, 0.015, 0.061, 0.016, 0.032, 0.108),
    (8, "Luo et al.", 0.021, 0.015, 0.039, 0.015, 0.025, 0.098),
]
# What the maps that MaterialGAN's authors published for these captures miss photos 7 and 8 by (RMSE, gamma 2.2).
MATERIALGAN = {"wood-walnut": 0.049, "leather-blue": 0.075, "wall-plaster-white": 0.041, "stone-spec-shiny": 0.033, "giftbag1": 0.071}
# Figures to reach: kind, what, set, photos, error, at most.
TARGETS = [
    ("must", "maps, 4 photos, re-rendering", "maps", 4, "ren", 0.045),
    ("must", "captures, photos kept out", "real", REAL_PHOTOS, "ren", 0.075),
    ("goal", "maps, 4 photos, re-rendering", "maps", 4, "ren", 0.032),
    ("goal", "maps, 4 photos, D linear", "maps", 4, "D", 0.024),
    ("goal", "maps, 4 photos, D gamma 2.2", "maps", 4, "D22", 0.024),
    ("goal", "maps, 4 photos, N", "maps", 4, "N", 0.015),
    ("goal", "maps, 4 photos, R linear", "maps", 4, "R", 0.061),
    ("goal", "maps, 4 photos, R gamma 2.2", "maps", 4, "R22", 0.061),
    ("goal", "maps, 4 photos, S linear", "maps", 4, "S", 0.016),
    ("goal", "maps, 4 photos, S gamma 2.2", "maps", 4, "S22", 0.016),
    ("goal", "maps, 8 photos, re-rendering", "maps", 8, "ren", 0.025),
    ("goal", "maps, 1 photo, re-rendering", "maps", 1, "ren", 0.055),
    ("goal", "captures, photos kept out", "real", REAL_PHOTOS, "ren", 0.035),
]
SYNTHETIC = (("maps", "Maps of Deschaintre et al."), ("textures", "Textures held out of training"))
ERRORS = ("D", "D22", "N", "angle", "R", "R22", "S", "S22", "ren", "lpips", "flip")
HEADS = ("D", "D γ", "N", "angle", "R", "R γ", "S", "S γ", "Ren.", "LPIPS", "FLIP")


def three(value):
    """A figure with three decimals, without the zero before the point."""
    if value is None:
        return "–"
    return f"{value:.3f}".removeprefix("0") if value < 1 else f"{value:.2f}"


def cell(error, value):
    """A figure of a table: angles in degrees with one decimal, all else with three."""
    return f"{value:.1f}°" if error == "angle" and value is not None else three(value)


def table(heads, rows):
    """A markdown table; the first column is text."""
    lines = ["| " + " | ".join(heads) + " |", "|---|" + "---:|" * (len(heads) - 1)]
    return "\n".join(lines + ["| " + " | ".join(map(str, row)) + " |" for row in rows])


class Figures:
    """What was measured, by (variant, set, material, photos)."""

    def __init__(self, figures):
        self.figures = figures

    def materials(self, kind):
        """The names of a set that were measured, in its order."""
        found = {name for _, of, name, _ in self.figures if of == kind}
        return [name for name in scenes.names(kind) if name in found]

    def of(self, variant, kind, photos):
        """The figures of one variant on the materials of a set."""
        return [f for (v, k, _, n), f in self.figures.items() if (v, k, n) == (variant, kind, photos)]

    def mean(self, variant, kind, photos, error):
        """The mean of an error over the materials of a set, or None where one is missing."""
        of = self.of(variant, kind, photos)
        if not of or len(of) < len(self.materials(kind)):
            return None
        return statistics.fmean(f["errors"][error] for f in of)

    def error(self, variant, kind, name, photos, error="ren"):
        """One error, or None."""
        found = self.figures.get((variant, kind, name, photos))
        return found and found["errors"][error]


def verdict(value, limit):
    """Whether a figure is reached, and by how much it is missed."""
    return "met" if value <= limit else f"missed by {100 * (value / limit - 1):.0f} %"


def targets(figures, variant, labels):
    """The table of figures to reach."""
    rows = []
    for kind, what, of, photos, error, limit in TARGETS:
        value = figures.mean(variant, of, photos, error)
        if value is not None:
            rows.append((what, kind, three(limit), three(value), verdict(value, limit)))
    if variant != BASELINE:
        for _, what, of, photos, *_ in (target for target in TARGETS if target[0] == "must"):
            ours, theirs = figures.mean(variant, of, photos, "ren"), figures.mean(BASELINE, of, photos, "ren")
            if ours is not None and theirs is not None:
                met = "missed, equal" if ours == theirs else verdict(ours, theirs)
                rows.append((f"{what}: better than `{labels[BASELINE]}`", "must", f"below {three(theirs)}", three(ours), met))
    return table(("figure", "", "at most", "measured", ""), rows) if rows else ""


def synthetic(figures, kind, variants):
    """Errors of all variants at each photo count."""
    rows = []
    for photos in scenes.PHOTOS:
        for variant in variants:
            values = [figures.mean(variant.name, kind, photos, error) for error in ERRORS]
            if any(value is not None for value in values):
                rows.append((variant.label, photos, *map(cell, ERRORS, values)))
    return table(("fit", "photos", *HEADS), rows)


def each(figures, kind, variant, photos):
    """Errors of one variant on each material."""
    rows = []
    for name in figures.materials(kind):
        if figures.error(variant, kind, name, photos) is not None:
            rows.append((name.split("__")[-1], *(cell(error, figures.error(variant, kind, name, photos, error)) for error in ERRORS)))
    return table(("material", *HEADS), rows)


def real(figures, variants):
    """Errors on the photos that were kept out of each capture."""
    names = figures.materials("real")
    rows, means = [], []
    for variant in variants:
        each_one = {name: figures.error(variant.name, "real", name, REAL_PHOTOS) for name in names}
        if any(value is not None for value in each_one.values()):
            means_of = (figures.mean(variant.name, "real", REAL_PHOTOS, error) for error in ("ren", "lpips", "flip"))
            rows.append((variant.label, *map(three, each_one.values()), *map(three, means_of)))
        if all(each_one.get(name) is not None for name in MATERIALGAN):
            means.append(f"{variant.label} {three(statistics.fmean(each_one[name] for name in MATERIALGAN))}")
    rows.append(("MaterialGAN, published maps", *(three(MATERIALGAN.get(name)) for name in names), *map(three, (None, None, None))))
    text = table(("fit", *names, "mean", "LPIPS", "FLIP"), rows)
    if means:
        theirs = three(statistics.fmean(MATERIALGAN.values()))
        text += f"\n\nMeans over the five captures that both have: MaterialGAN {theirs}; {', '.join(means)}."
    return text


def median(figures, key):
    """The median of a figure over fits."""
    return statistics.median(f[key] for f in figures)


def stages(fits):
    """What the stages of a fit took, as text."""
    names = [stage["stage"] for stage in fits[0]["report"]["stages"]]
    parts = []
    for number, name in enumerate(names):
        of = [f["report"]["stages"][number] for f in fits if len(f["report"]["stages"]) == len(names)]
        steps, seconds = (statistics.median(stage[key] for stage in of) for key in ("steps", "seconds"))
        parts.append(f"{name} {seconds:.1f} s" + (f" ({steps:.0f} steps)" if steps else ""))
    return ", ".join(parts)


def trade(figures, variants):
    """Time, memory and errors of every variant."""
    rows = []
    for variant in variants:
        for label, kind, photos in (("maps", "maps", 4), ("captures", "real", REAL_PHOTOS)):
            fits = figures.of(variant.name, kind, photos)
            if fits:
                errors = [three(figures.mean(variant.name, kind, photos, e)) for e in ("ren", "lpips")]
                time = [f"{median(fits, key):.1f}" for key in ("seconds", "processor")]
                rows.append((variant.label, label, photos, *time, f"{median(fits, 'memory') / 1e6:.0f}", *errors, stages(fits)))
    return table(("fit", "on", "photos", "seconds", "processor seconds", "peak MB", "Ren.", "LPIPS", "stages"), rows)


def trade_panels(figures, variants):
    """The same for the plot."""
    panels = []
    published = [(f"{method} (published, other materials)", ren) for n, method, *_, ren, _ in PUBLISHED if n == 4 and method == "Luo et al."]
    materialgan = [("MaterialGAN's published maps (five of the six)", statistics.fmean(MATERIALGAN.values()))]
    for title, kind, photos, error, lines in (
        ("Maps, 4 photos", "maps", 4, "re-rendering RMSE, gamma 2.2", published),
        ("Captures, 7 photos", "real", REAL_PHOTOS, "RMSE on the photos kept out, gamma 2.2", materialgan),
    ):
        points = [
            (v.label, median(figures.of(v.name, kind, photos), "seconds"), figures.mean(v.name, kind, photos, "ren"))
            for v in variants
            if figures.mean(v.name, kind, photos, "ren") is not None
        ]
        if points:
            panels.append((title, error, points, lines))
    return panels


def photo_panels(figures, variants):
    """Re-rendering error over the photo count, for variants measured with more than one count."""
    panels = []
    luo = [(n, ren) for n, method, *_, ren, _ in PUBLISHED if method == "Luo et al."]
    for kind, title in SYNTHETIC:
        lines = []
        for variant in variants:
            found = [(n, figures.mean(variant.name, kind, n, "ren")) for n in scenes.PHOTOS]
            found = [(n, value) for n, value in found if value is not None]
            if len(found) > 1:
                lines.append((variant.label, *zip(*found, strict=True), False))
        if lines:
            panels.append((title, [*lines, ("Luo et al., published, other materials", *zip(*luo, strict=True), True)]))
    return panels


def machine():
    """The processor this ran on."""
    names = [line.split(":", 1)[1].strip() for line in Path("/proc/cpuinfo").read_text().splitlines() if line.startswith("model name")]
    return f"{names[0] if names else 'unknown processor'}, {os.cpu_count()} threads"


def write(measured, store, variants, folder):
    """Writes `accuracy.md` into `folder` and what it shows into `images/accuracy` there; other pictures go to the store. Returns a summary."""
    figures = Figures(measured)
    if not measured:
        return "nothing was measured"
    variants = [v for v in variants if any(key[0] == v.name for key in measured)]
    labels = {v.name: v.label for v in variants}
    shown = HEADLINE if HEADLINE in labels else BASELINE if BASELINE in labels else variants[0].name
    variant = next(v for v in variants if v.name == shown)
    images = folder / "images" / "accuracy"
    text = [HEAD.format(shown=labels[shown], machine=machine())]

    def section(title, *parts):
        text.append(f"## {title}\n" + "\n\n".join(part for part in parts if part))

    def picture(name, draw, alt):
        draw(images / name)
        return f"![{alt}](images/accuracy/{name})"

    if goals := targets(figures, shown, labels):
        section("The figures to reach", f"Of the fit `{labels[shown]}`.", goals)
    synthetic_sets = [(kind, title) for kind, title in SYNTHETIC if figures.materials(kind)]
    if synthetic_sets:
        section("Synthetic materials", SYNTHETIC_TEXT)
        for kind, title in synthetic_sets:
            text.append(f"### {title} ({len(figures.materials(kind))})\n{synthetic(figures, kind, variants)}")
        rows = [(method, n, *(three(v) for v in values)) for n, method, *values in PUBLISHED]
        text.append(f"### Published figures\n{PUBLISHED_TEXT}\n\n{table(('method', 'photos', 'D', 'N', 'R', 'S', 'Ren.', 'LPIPS'), rows)}")
        if panels := photo_panels(figures, variants):
            text.append(picture("photos.png", lambda path: plots.photos(path, panels), "Re-rendering error over the number of photos"))
    if shares := certainty(figures, store, variant):
        section("How sure the fits are", CERTAINTY_TEXT.format(shown=labels[shown]), shares)
    if rows := expectations(figures, variant):
        section("What the verdicts expect", EXPECTATIONS_TEXT.format(shown=labels[shown]), rows)
    if figures.materials("real"):
        section("Real captures", REAL_TEXT, real(figures, variants))
    if panels := trade_panels(figures, variants):
        plot = picture("trade.png", lambda path: plots.trade(path, panels), "Error over time, every fit")
        section("What the time buys", TRADE_TEXT, trade(figures, variants), plot)
    if synthetic_sets:
        tables = [f"### {title}\n{each(figures, kind, shown, 4)}" for kind, title in synthetic_sets if figures.of(shown, kind, 4)]
        if tables:
            section("Each material, four photos", f"Of the fit `{labels[shown]}`.", *tables)
    if parts := pictures(figures, store, variant, picture):
        encoded = "D, S and the re-rendering (Ren., one of the twenty) in gamma 2.2, N as (n + 1) / 2, R as it is"
        about = f"Truth and the fit `{labels[shown]}` to four photos: {encoded}."
        section("Pictures", about, *parts)
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "accuracy.md").write_text("\n\n".join(text) + "\n")
    return f"{folder / 'accuracy.md'}; pictures that are not to be published in {store.folder / 'sheets'}"


def certainty(figures, store, variant):
    """How often the truth lies within one standard deviation."""
    rows = []
    for kind, title in SYNTHETIC:
        for photos in scenes.PHOTOS:
            shares = []
            for name in figures.materials(kind):
                folder = store.place(variant, kind, name, photos)[0]
                if figures.error(variant.name, kind, name, photos) is None or not (deviations := scenes.load_deviations(folder)):
                    continue
                shares.append(covered(scenes.load_fit(folder)[0], deviations, scenes.truth(kind, name)))
            if shares:
                rows.append((title, photos, *(f"{100 * statistics.fmean(share[letter] for share in shares):.0f} %" for letter in "DNRS")))
    return table(("on", "photos", "D", "N", "R", "S"), rows) if rows else ""


def expectations(figures, variant):
    """What the verdicts expected of new views, and what these were missed by."""
    rows = []
    for kind, title in (*SYNTHETIC, ("real", "Captures")):
        for photos in (REAL_PHOTOS,) if kind == "real" else scenes.PHOTOS:
            fits = [f for f in figures.of(variant.name, kind, photos) if f["report"].get("expected_error")]
            if not fits:
                continue
            real = [f["errors"]["ren"] for f in fits]
            cells = [three(statistics.fmean(real))]
            for key in ("expected_error", "material_error"):
                expected = [f["report"][key] for f in fits]
                off = statistics.median(abs(math.log(e / r)) for e, r in zip(expected, real, strict=True))
                cells += [three(statistics.fmean(expected)), f"{100 * (math.exp(off) - 1):.0f} %"]
            rows.append((title, photos, *cells))
    heads = ("on", "photos", "missed by", "expected", "off by", "expected of the material", "off by")
    return table(heads, rows) if rows else ""


def pictures(figures, store, variant, picture):
    """Sheets of the textures that may be shown, as markdown; those of all else are only written to the store."""
    for kind in ("maps", "textures"):
        for photos in scenes.PHOTOS:
            names = [n for n in figures.materials(kind) if figures.error(variant.name, kind, n, photos) is not None]
            if names:
                sheets.synthetic(store.folder / "sheets" / f"{variant.name}-{kind}-{photos}.jpg", store, variant, kind, names, photos)
    names = [n for n in figures.materials("real") if figures.error(variant.name, "real", n, REAL_PHOTOS) is not None]
    if names:
        sheets.real(store.folder / "sheets" / f"{variant.name}-real.jpg", store, variant, names)
    free = [n for n in figures.materials("textures") if figures.error(variant.name, "textures", n, 4) is not None and scenes.is_cc0(n)]
    parts = []
    for number, start in enumerate(range(0, len(free), 12), 1):
        some = free[start : start + 12]
        alt = "True and fitted maps of " + ", ".join(n.split("__")[-1] for n in some)
        parts.append(picture(f"textures-{number}.jpg", lambda path, some=some: sheets.synthetic(path, store, variant, "textures", some, 4), alt))
    return parts


HEAD = """# Accuracy

How far the fits are from the truth, measured by `make accuracy`, which writes this page. It needs the measuring data, which is not part of the
project; the scripts are in `tests/accuracy`. All at 256 x 256 pixels with the seed 0. Measured on: {machine}."""

SYNTHETIC_TEXT = f"""True maps are rendered as 8-bit photos in gamma 2.2 by a renderer in numpy that shares no code with the fit. The patch is 2 wide; camera and
light stand together {scenes.HEIGHT} above it, the first photo straight above its centre, the others up to {scenes.REACH} beside; a white diffuse patch at the
centre reads 1 in the first. One photo is the first of these, four the first four. The fitted maps are then rendered from {scenes.TESTS} other places on
the same disc and compared with renderings of the true maps, not rounded to 8 bits.

D, N, R, S: RMSE of diffuse albedo, normal as (n + 1) / 2, roughness and specular albedo, linear, and in gamma 2.2 (γ). Angle: the mean between
fitted and true normals. Ren.: RMSE of the renderings in gamma 2.2, clamped to [0, 1]. LPIPS: version 0.1 with AlexNet, of the same pictures. FLIP:
mean, for screens at 67 pixels a degree. All are means over the renderings, then over the materials. Less is better."""

PUBLISHED_TEXT = """From Luo et al. 2024, over 300 synthetic materials of theirs, 20 random lights. They are not the materials above and the encoding of the maps is
not stated, so that only the order of size compares."""

CERTAINTY_TEXT = """The share of pixels of the fit `{shown}` whose error is within the standard deviation that it states, of colours their root mean squares. Were errors Gaussian
and the deviations right, it would be 61 % for D and S, 63 % for N and 68 % for R."""

EXPECTATIONS_TEXT = """The error of new views that the fit `{shown}` expects (`expected_error`, and `material_error`, what is left of it after a smooth gain), beside what they were missed by: means over
the materials, and by which factor the expectation is off in the median. A single photo's expectation comes from the network's deviations, all others from photos that were left out. New
views of synthetic materials stand in exact light: there the material's part is what compares."""

REAL_TEXT = """Six captures by the authors of MaterialGAN, nine photos each; photos 0 to 6 are fitted, 7 and 8 kept out. Figures are the RMSE of the two
re-rendered photos in gamma 2.2. MaterialGAN: the maps that its authors published for the same captures. Camera and light of all but `cards-blue`
were recovered from published re-renderings, so that distances are right to a few per cent."""

TRADE_TEXT = """Medians over the maps with four photos and over the captures with seven. Seconds are those of the fit without reading and writing files,
processor seconds and peak memory those of the whole command. Other programs may have run meanwhile; processor seconds suffer less from that."""
