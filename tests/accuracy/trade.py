#!/usr/bin/env python3
"""What time and memory buy: one option at a time around the preset `balanced`. Writes docs/trade.md and its plot.

    trade.py [--count 6] [--binary target/release/svbrdf-gcn] [--out out/accuracy] [--report docs]

`--count` materials of each set (maps of Deschaintre et al., textures held out, real captures) at 256 x 256, evenly spread by name. One fit at a time, on all
threads. Fits and figures are kept in the store of accuracy.py: a run that was cut off goes on where it stopped.
"""

import argparse
import statistics
import sys
from pathlib import Path

import matplotlib

matplotlib.use("Agg")

import matplotlib.pyplot as plt
import plots
import report
import scenes
from fitting import Store
from variants import Variant

BALANCED = Variant("balanced", "balanced", ("--preset", "balanced"))
# The options that are changed, one at a time: (what changes, the variants).
AXES = [
    ("preset", [Variant("draft", "draft", ("--preset", "draft")), BALANCED, Variant("high", "high", ("--preset", "high"))]),
    ("steps of direct", [Variant(f"trade-direct-{n}", f"{n}", ("--direct-steps", str(n))) for n in (50, 150, 600, 1200)]),
    ("steps of the finish", [Variant(f"trade-finish-{n}", f"{n}", ("--finish-steps", str(n))) for n in (0, 4, 40)]),
    ("reflectance", [Variant(f"trade-{n}", n, ("--reflectance", n)) for n in ("diffuse", "dielectric", "isotropic", "anisotropic")]),
    ("light", [Variant(f"trade-refine-{n}", n, ("--refine", n)) for n in ("none", "light", "all")]),
    (
        "network",
        [
            Variant("network", "network only", ("--direct-steps", "0", "--finish-steps", "0")),
            Variant("direct-balanced", "none", ("--method", "direct", "--preset", "balanced")),
        ],
    ),
]
PHOTOS = 4
SETS = (("maps", "maps"), ("textures", "textures"), ("real", "captures"))

HEAD = """# What time and memory buy

Measured by `make trade`: {count} materials each of the synthetic maps and of the textures held out (four photos), and {count} real captures (seven photos in, two kept out), all at 256 x 256. One option at a time is
changed from `balanced`. Seconds are the processor's, of the whole command on all threads, in the median over all three sets: other programs disturb them less than a clock on the wall; memory is the peak of the process. Errors: RMSE of new views in gamma 2.2, mean over the set; of
maps, the mean of the errors of diffuse albedo, roughness and specular albedo (linear) and of the normal as (n + 1) / 2. Machine: {machine}.

A fit is on the frontier (**bold**) if no other one here is both faster and better in the mean of the three errors of new views.
"""


def spread(names, count):
    """`count` of the names, evenly spread."""
    count = min(count, len(names))
    return [names[i * len(names) // count] for i in range(count)]


def mean(values):
    """The mean, or None of nothing."""
    values = list(values)
    return statistics.fmean(values) if values else None


class Row:
    """A variant's figures over all sets."""

    def __init__(self, axis, variant, photos, figures):
        self.axis, self.variant, self.photos = axis, variant, photos
        fits = [f for of_set in figures.values() for f in of_set]
        self.seconds = statistics.median(f["processor"] for f in fits)
        self.memory = max(f["memory"] for f in fits)
        self.errors = [mean(f["errors"]["ren"] for f in figures[kind]) if kind in figures else None for kind, _ in SETS]
        synthetic = [f["errors"] for kind in ("maps", "textures") for f in figures.get(kind, [])]
        self.maps = mean(mean(errors[letter] for letter in "DRSN") for errors in synthetic)

    @property
    def error(self):
        return mean(error for error in self.errors if error is not None)

    def cells(self, bold):
        label = f"**{self.variant.label}**" if bold else self.variant.label
        errors = [report.three(error) if error is not None else "" for error in (*self.errors, self.maps)]
        return (self.axis, label, self.photos, f"{self.seconds:.1f}", f"{self.memory / 1e6:.0f}", *errors)


def frontier(rows):
    """The rows that no other one beats in both time and error."""
    return [row for row in rows if not any(other.seconds <= row.seconds and other.error < row.error for other in rows if other is not row)]


def plot(path, rows, best):
    """Error over time, the frontier as a line."""
    figure, axis = plt.subplots(figsize=(8, 4.5), layout="constrained")
    for number, name in enumerate(dict.fromkeys(row.axis for row in rows)):
        of_axis = [row for row in rows if row.axis == name]
        axis.plot([r.seconds for r in of_axis], [r.error for r in of_axis], "os^Dv<>p"[number % 8], color=f"C{number}", label=name)
        for row in of_axis:
            axis.annotate(row.variant.label, (row.seconds, row.error), xytext=(5, 4), textcoords="offset points", fontsize=8)
    line = sorted((row.seconds, row.error) for row in best)
    axis.plot(*zip(*line, strict=True), color="0.6", linewidth=1, zorder=0)
    axis.set(xlabel="processor seconds a fit", ylabel="RMSE of new views, gamma 2.2, mean of the three sets", xscale="log", ylim=(0, None))
    axis.legend(fontsize=8)
    axis.grid(alpha=0.3, which="both")
    plots.finish(figure, path)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--count", type=int, default=6, help="materials of each set")
    parser.add_argument("--binary", type=Path, default=scenes.ROOT / "target" / "release" / "svbrdf-gcn")
    parser.add_argument("--out", type=Path, default=scenes.ROOT / "out" / "accuracy", help="folder of fits and figures")
    parser.add_argument("--report", type=Path, default=scenes.ROOT / "docs", help="folder of trade.md")
    chosen = parser.parse_args()
    store = Store(chosen.out, chosen.binary.resolve())
    jobs = [(axis, variant, PHOTOS) for axis, variants in AXES for variant in variants]
    jobs += [("photos", BALANCED, count) for count in scenes.PHOTOS if count != PHOTOS]
    rows = []
    for number, (axis, variant, photos) in enumerate(jobs):
        print(f"[{number + 1}/{len(jobs)}] {axis}: {variant.label}, {photos} photos", file=sys.stderr, flush=True)
        figures = {}
        # Captures have seven photos in any case.
        for kind, _ in SETS if photos == PHOTOS else SETS[:2]:
            count = len(scenes.PHOTOS_IN) if kind == "real" else photos
            for name in spread(scenes.names(kind), chosen.count):
                store.fit(variant, kind, name, count)
                store.measure(kind, name, [(variant, count)])
                figures.setdefault(kind, []).append(store.kept(variant, kind, name, count))
        rows.append(Row(axis, variant, photos, figures))
    # Other numbers of photos are other tasks, not faster or better ways.
    compared = [row for row in rows if row.axis != "photos"]
    best = frontier(compared)
    heads = ("changed", "to", "photos", "processor seconds", "peak MB", *(f"new views, {label}" for _, label in SETS), "maps")
    table = report.table(heads, [row.cells(row in best) for row in rows])
    plot(chosen.report / "images" / "accuracy" / "trade-frontier.png", compared, best)
    head = HEAD.format(count=chosen.count, machine=report.machine())
    picture = "![Error over time: one option at a time around balanced](images/accuracy/trade-frontier.png)"
    (chosen.report / "trade.md").write_text(f"{head}\n{table}\n\n{picture}\n")


if __name__ == "__main__":
    main()
