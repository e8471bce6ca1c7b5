"""What every self-contained page of percept shares: templates, assets, figures and the sign for no number."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache
from importlib import resources

from jinja2 import ChoiceLoader, Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

#: What stands on a page where there is no number.
NO_NUMBER = Markup('<span class="none">–</span>')


@dataclass(frozen=True)
class Plate:
    """A figure for a page."""

    title: str
    description: str
    svg: str  # An ``<svg>`` element as `percept.report.figures.files.Picture.inline` writes it


def figures(plates: Mapping[str, Plate]) -> Callable[[str], Markup]:
    """Return what gives templates a figure by its name."""

    def figure(name: str) -> Markup:
        return Markup(plates[name].svg)

    return figure


@cache
def templates(*packages: str) -> Environment:
    """Return the templates of packages; a name is looked for in the order of the packages."""
    return Environment(
        loader=ChoiceLoader([PackageLoader(package) for package in packages]),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )


@cache
def asset(package: str, name: str) -> Markup:
    """Return a style sheet or script of a package's templates, as it stands."""
    return Markup(resources.files(package).joinpath("templates", name).read_text(encoding="utf-8"))
