"""The command line: ``python -m svbrdf_gcn fit my-capture -o my-material``."""

import sys

from ._svbrdf_gcn import command_line


def main() -> int:
    """Run the command line with the arguments of this process and return its exit code."""
    return command_line(["svbrdf-gcn", *sys.argv[1:]])


if __name__ == "__main__":
    sys.exit(main())
