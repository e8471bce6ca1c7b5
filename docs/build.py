"""Build the API's pages from docstrings: python docs/build.py FOLDER."""

from __future__ import annotations

import importlib
import pkgutil
import sys
from pathlib import Path

import pdoc

import percept

_NOT_API = {"commands", "bench", "cli", "__main__"}


def public_modules() -> list[str]:
    """Return percept, its packages and modules, and the packages inside them."""
    names = ["percept"]
    for module in pkgutil.iter_modules(percept.__path__, "percept."):
        last = module.name.rpartition(".")[2]
        if last.startswith("_") or last in _NOT_API:
            continue
        names.append(module.name)
        if module.ispkg:
            inner = importlib.import_module(module.name).__path__
            names += [part.name for part in pkgutil.iter_modules(inner, f"{module.name}.") if part.ispkg]
    return names


def resolve(name: str) -> None:
    """Put the names a module resolves on first use where pdoc looks for them."""
    module = importlib.import_module(name)
    for public in getattr(module, "__all__", ()):
        setattr(module, public, getattr(module, public))


def main(folder: str) -> int:
    """Write the pages and print where they begin."""
    names = public_modules()
    for name in names:
        resolve(name)
    pdoc.render.configure(docformat="numpy", show_source=False, footer_text=f"percept {percept.__version__}")
    pdoc.pdoc(*names, output_directory=Path(folder))
    sys.stdout.write(f"{Path(folder) / 'percept.html'}\n")
    return 0


if __name__ == "__main__":
    raise SystemExit(main(*sys.argv[1:]))
