"""The command line: ``python -m svbrdf_gcn fit my-capture -o my-material``."""

import sys

from ._svbrdf_gcn import command_line


def main() -> int:
    """Run the command line with the arguments of this process and return its exit code."""
    arguments = sys.argv[1:]
    if arguments[:1] == ["train"] and "--python" not in arguments:
        # The trainer runs in this Python.
        arguments[1:1] = ["--python", sys.executable]
    return command_line(["svbrdf-gcn", *arguments])


if __name__ == "__main__":
    sys.exit(main())
