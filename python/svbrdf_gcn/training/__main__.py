"""The trainer: ``python -m svbrdf_gcn.training CONFIG -o FOLDER``."""

import sys
from importlib.util import find_spec


def main():
    """Train as the arguments of this process say."""
    missing = [name for name in ("torch", "PIL") if find_spec(name) is None]
    if missing:
        sys.exit(f"svbrdf_gcn.training: {sys.executable} does not have {', '.join(missing)}: install with: python -m pip install 'svbrdf-gcn[training]'")
    from .train import main as train

    train()


if __name__ == "__main__":
    main()
