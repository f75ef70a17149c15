"""``python -m seepd``: the program, and ``seepd fleet``, which is written in Python."""

from __future__ import annotations

import sys


def main() -> int:
    """Runs the program; gives its exit code."""
    if sys.argv[1:2] == ["fleet"]:
        from .fleet.cli import main as fleet

        return fleet(sys.argv[2:])
    from . import _core

    return _core.main(["seepd", *sys.argv[1:]])


if __name__ == "__main__":
    sys.exit(main())
