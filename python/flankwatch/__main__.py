"""``python -m flankwatch import FOLDER …``."""

from __future__ import annotations

import sys

from .importing import main as import_folder


def main() -> int:
    """Runs the command that the first argument names."""
    if sys.argv[1:2] == ["import"]:
        return import_folder(sys.argv[2:])
    print("usage: python -m flankwatch import FOLDER --asset ID [--url URL]", file=sys.stderr)
    return 2


if __name__ == "__main__":
    sys.exit(main())
