#!/usr/bin/env python3
"""Measures the accuracy of the fits and writes docs/accuracy.md with its plots and pictures.

    accuracy.py [--sets maps,textures,real] [--variants NAME,...] [--materials NAME,...] [--quick] [--report-only]

Needs the measuring data beside the repository (`SVBRDF_GCN_SHARED` names another place). Fits and figures are kept in out/accuracy: the same program
with the same arguments does not fit again. A run that is not the whole of it reports to out/accuracy/report instead of docs.
"""

import argparse
import os
import sys
import time
from pathlib import Path

# Measurements run side by side, one thread each. Set before numpy is loaded.
os.environ.update(OPENBLAS_NUM_THREADS="1", OMP_NUM_THREADS="1")

import multiprocessing

import report
import scenes
from fitting import Store
from variants import BASELINE, HEADLINE, VARIANTS

SETS = ("maps", "textures", "real")
QUICK_MATERIALS = ("d18_0000027", "d19_4_Pattern_Tile", "cards-blue", "bruuucechang__walnut")


def plan(variants, sets, materials, counts):
    """All fits: (variant, set, material, photos)."""
    jobs = []
    for kind in sets:
        for name in scenes.names(kind):
            if materials and name not in materials:
                continue
            for photos in (len(scenes.PHOTOS_IN),) if kind == "real" else counts:
                traded = kind == "real" or (kind == "maps" and photos == 4)
                jobs += [(variant, kind, name, photos) for variant in variants if variant.everywhere or traded]
    return jobs


def measure(arguments):
    """One process's share: the errors of all fits of one material."""
    store, kind, name, fits = arguments
    store.measure(kind, name, fits)
    return name


def names_list(text):
    """Names separated by commas."""
    return tuple(part.strip() for part in text.split(",") if part.strip())


def progress(done, count, text):
    """A line on standard error."""
    print(f"[{done}/{count}] {text}", file=sys.stderr, flush=True)


def options(arguments):
    """The command line, checked."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sets", type=names_list, default=SETS, help="maps,textures,real")
    parser.add_argument("--variants", type=names_list, default=tuple(v.name for v in VARIANTS), help="names in variants.py")
    parser.add_argument("--materials", type=names_list, default=(), help="only these")
    parser.add_argument("--photos", type=names_list, default=(), help="only these numbers of photos, of 1,4,8")
    parser.add_argument("--quick", action="store_true", help="a few materials, four photos, one variant unless --variants names others")
    parser.add_argument("--report-only", action="store_true", help="fit and measure nothing, report what is kept")
    parser.add_argument("--binary", type=Path, default=scenes.ROOT / "target" / "release" / "svbrdf-gcn", help="the command line to measure")
    parser.add_argument("--out", type=Path, default=scenes.ROOT / "out" / "accuracy", help="folder of fits, figures and other pictures")
    parser.add_argument("--report", type=Path, help="folder of accuracy.md; docs for the whole of it")
    chosen = parser.parse_args(arguments)
    known = {"--sets": SETS, "--variants": [v.name for v in VARIANTS], "--materials": [n for kind in SETS for n in scenes.names(kind)]}
    for option, given in (("--sets", chosen.sets), ("--variants", chosen.variants), ("--materials", chosen.materials)):
        for name in given:
            if name not in known[option]:
                parser.error(f"{option}: expected one of {', '.join(known[option])}, got {name}")
    unknown = set(chosen.photos) - {str(count) for count in scenes.PHOTOS}
    if unknown:
        parser.error(f"--photos: expected some of {scenes.PHOTOS}, got {', '.join(unknown)}")
    chosen.counts = tuple(map(int, chosen.photos)) or scenes.PHOTOS
    if chosen.quick:
        chosen.materials, chosen.counts = chosen.materials or QUICK_MATERIALS, (4,)
        if chosen.variants == parser.get_default("variants"):
            chosen.variants = (HEADLINE if HEADLINE in chosen.variants else BASELINE,)
    whole = not chosen.quick and not chosen.materials and not chosen.photos and chosen.sets == SETS and chosen.variants == parser.get_default("variants")
    chosen.report = chosen.report or (scenes.ROOT / "docs" if whole else chosen.out / "report")
    return chosen


def main(arguments=None):
    chosen = options(arguments)
    store = Store(chosen.out, chosen.binary)
    variants = [variant for variant in VARIANTS if variant.name in chosen.variants]
    jobs = plan(variants, chosen.sets, chosen.materials, chosen.counts)
    if not chosen.report_only:
        # One fit at a time, so that times and memory are those of a fit that has the machine to itself.
        for done, (variant, kind, name, photos) in enumerate(jobs, 1):
            start = time.monotonic()
            figures = store.fit(variant, kind, name, photos)
            if time.monotonic() - start > 0.5:
                progress(done, len(jobs), f"{variant.name} {name} {photos}: {figures['seconds']:.1f} s")
        shares = {}
        for variant, kind, name, photos in jobs:
            shares.setdefault((kind, name), []).append((variant, photos))
        with multiprocessing.get_context("spawn").Pool(os.cpu_count()) as pool:
            work = [(store, kind, name, fits) for (kind, name), fits in shares.items()]
            for done, name in enumerate(pool.imap_unordered(measure, work), 1):
                progress(done, len(work), f"measured {name}")
    figures = {(v.name, kind, name, photos): kept for v, kind, name, photos in jobs if (kept := store.kept(v, kind, name, photos))}
    print(report.write(figures, store, variants, chosen.report))


if __name__ == "__main__":
    main()
