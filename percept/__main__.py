"""percept on the command line: `python -m percept`."""

from __future__ import annotations

from percept.cli import main

__all__: list[str] = []

if __name__ == "__main__":
    raise SystemExit(main())
