"""percept on the command line: `python -m percept`."""

from __future__ import annotations

from percept.cli import main

if __name__ == "__main__":
    raise SystemExit(main())
