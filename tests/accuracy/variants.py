"""The ways to fit that are measured. A new one is one more entry of `VARIANTS`."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Variant:
    """A way to fit.

    `arguments` go to `svbrdf-gcn fit` as they are. `everywhere`: measured on every set and photo count, else only where the table of time and
    memory needs it (the maps with four photos, the captures).
    """

    name: str
    label: str
    arguments: tuple[str, ...]
    everywhere: bool = False


VARIANTS = [
    Variant("network", "network only", ("--direct-steps", "0", "--finish-steps", "0")),
    Variant("network-finish", "network, finish", ("--direct-steps", "0")),
    Variant("draft", "draft", ("--preset", "draft")),
    Variant("balanced", "balanced", ("--preset", "balanced"), everywhere=True),
    Variant("high", "high", ("--preset", "high")),
    Variant("direct-balanced", "direct, balanced", ("--method", "direct", "--preset", "balanced"), everywhere=True),
]

# What the figures to reach are about, and what it has to beat. Where the first was not measured the second is reported alone.
HEADLINE = "balanced"
BASELINE = "direct-balanced"
