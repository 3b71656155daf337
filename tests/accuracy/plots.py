"""The plots of the report."""

import matplotlib

matplotlib.use("Agg")

import matplotlib.pyplot as plt
from matplotlib.ticker import LogLocator, NullFormatter, StrMethodFormatter


def finish(figure, path):
    """Writes a figure as PNG."""
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=90)
    plt.close(figure)


def trade(path, panels):
    """Error over time. `panels`: (title, label of the error, [(label, seconds, error)], [(label, error)] of lines across)."""
    figure, axes = plt.subplots(1, len(panels), figsize=(10, 4), layout="constrained", squeeze=False)
    for axis, (title, error, points, lines) in zip(axes[0], panels, strict=True):
        for number, (label, seconds, value) in enumerate(points):
            axis.plot(seconds, value, "os^Dv<>ph*"[number % 10], color=f"C{number % 10}", markersize=8, label=label)
        for label, value in lines:
            axis.axhline(value, color="0.55", linestyle="--", linewidth=1)
            axis.annotate(label, (0.01, value), xycoords=("axes fraction", "data"), va="bottom", fontsize=8, color="0.35")
        axis.set_xscale("log")
        low, high = (f(seconds for _, seconds, _ in points) for f in (min, max))
        axis.set_xlim(low / 2, high * 2)
        axis.set_ylim(0, 1.2 * max([value for *_, value in points] + [value for _, value in lines]))
        axis.xaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
        axis.xaxis.set_major_formatter(StrMethodFormatter("{x:g}"))
        axis.xaxis.set_minor_formatter(NullFormatter())
        axis.set(title=title, xlabel="seconds a fit", ylabel=error)
        axis.grid(alpha=0.3, which="both")
        axis.legend(fontsize=8, loc="upper right")
    finish(figure, path)


def photos(path, panels):
    """Error over the number of photos. `panels`: (title, [(label, counts, errors, whether published)])."""
    figure, axes = plt.subplots(1, len(panels), figsize=(10, 4), layout="constrained", squeeze=False)
    for axis, (title, lines) in zip(axes[0], panels, strict=True):
        for label, counts, errors, published in lines:
            axis.plot(counts, errors, "s--" if published else "o-", color="0.5" if published else None, label=label)
        axis.set(title=title, xlabel="photos", ylabel="re-rendering RMSE, gamma 2.2", ylim=(0, None))
        axis.set_xticks(sorted({count for _, counts, *_ in lines for count in counts}))
        axis.grid(alpha=0.3)
        axis.legend(fontsize=8)
    finish(figure, path)
