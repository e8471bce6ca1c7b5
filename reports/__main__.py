"""Make a page of the reports: `python -m reports NAME --out DIR`."""

from __future__ import annotations

import argparse
import inspect
import os
import platform
import shlex
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from pkgutil import resolve_name

from percept.errors import PerceptError
from percept.provenance import made_by
from reports.page import Page

#: What makes each page: a function of its folder and of options, which have defaults.
PAGES = {
    "hbfd": "reports.hbfd.page:page",
    "digits": "reports.benchmark.digits:page",
    "commands": "reports.benchmark.commands:page",
    "scale": "reports.benchmark.commands:scale",
    "designs": "reports.benchmark.designs:page",
    "samplers": "reports.benchmark.samplers:page",
    "reference": "reports.benchmark.reference:page",
    "sbc": "reports.calibration.fits:page",
    "verdicts": "reports.coverage.rates:page",
    "equivalence": "reports.equivalence.rates:page",
    "loop": "reports.evidence.loop:page",
}
_PACKAGES = ("numpy", "scipy", "pandas", "emcee", "arviz-stats", "matplotlib", "pymc", "nutpie")


def main(words: Sequence[str] | None = None) -> int:
    """Make one page and print its path; return 1 where it shows that something is wrong."""
    chooser = argparse.ArgumentParser("python -m reports", description=__doc__)
    chooser.add_argument("name", choices=PAGES, help="the page")
    chooser.add_argument("options", nargs=argparse.REMAINDER, help="NAME --help lists them")
    chosen = chooser.parse_args(words)
    make = resolve_name(PAGES[chosen.name])
    parser = _parser(f"{chooser.prog} {chosen.name}", make)
    options = vars(parser.parse_args(chosen.options))
    started = time.perf_counter()
    load = os.getloadavg()[0]
    try:
        page: Page = make(**options)
    except PerceptError as error:
        print(f"{parser.prog}: {error}", file=sys.stderr)
        return error.exit_code
    made = made_by(f"{parser.prog} {shlex.join(chosen.options)}", _PACKAGES)
    page.add(
        f"{made.sentence} It took {time.perf_counter() - started:.0f} s on {os.cpu_count()}"
        f" processors ({platform.system()}, {platform.machine()}), load {load:.1f} before and"
        f" {os.getloadavg()[0]:.1f} after."
    )
    path = options["out"] / f"{chosen.name}.md"
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(page.text, encoding="utf-8")
    print(path)
    return int(not page.right)


def _parser(prog: str, make: Callable[..., Page]) -> argparse.ArgumentParser:
    """Return a parser of the options that a function of a page takes."""
    parser = argparse.ArgumentParser(
        prog,
        description=inspect.getdoc(make),
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--out", type=Path, required=True, help="folder of the page")
    for name, parameter in inspect.signature(make).parameters.items():
        default = parameter.default
        if name == "out":
            continue
        option = f"--{name}"
        if isinstance(default, bool):
            parser.add_argument(option, action="store_true")
        elif isinstance(default, tuple):
            parser.add_argument(option, nargs="+", default=default, help="(all)")
        else:
            parser.add_argument(option, type=type(default), default=default, help=f"({default})")
    return parser


if __name__ == "__main__":
    sys.exit(main())
