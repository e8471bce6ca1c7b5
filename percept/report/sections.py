"""The sections of the page that give results; each is made of the results, or is None."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, Generic, TypeVar

from percept.boundary.band import size_name
from percept.report.basis import checks, comparison, data, diagnostics, methods
from percept.report.contrast import contrast
from percept.report.feelings import feelings, rendering_sentences
from percept.report.overview import first_screen
from percept.report.people import people
from percept.report.psychophysics import psychophysics
from percept.report.select import (
    KINDS,
    METHODS,
    Section,
    choice_said,
    chosen,
    distinct,
    each_by_itself,
    families_of,
    family_of,
    first,
    matching,
    ordered,
    words_of,
)
from percept.results import (
    Band,
    BandLaw,
    BandRow,
    BandStatement,
    Boundary,
    Findings,
    IntervalRow,
    Membership,
    Results,
    plain,
)
from percept.results.fields import Array
from percept.scene import Scene
from percept.sessions.quantities import Quantity

__all__ = ["Intervals", "Matrix", "build_sections", "intervals"]

R = TypeVar("R", IntervalRow, Membership)

_SHAPES = {
    "corner": (
        "both lower limits of k and b together, and both upper limits together, as in the paper"
        " (Eqs 16 and 17); the two curves can cross"
    ),
    "envelope": (
        "the exact smallest and largest |Z_h| that any k and b within their limits can give"
    ),
    "pointwise": "limits of |Z_h| by the law of k and b together; the level holds at each ω alone",
    "simultaneous": (
        "limits between which a whole curve stays at every ω drawn: pointwise limits at a higher"
        " level (Bayesian), or limits of Hotelling’s ellipse joined with the pointwise ones"
        " (classical)"
    ),
}
_LAWS = {
    "weber": "Weber, w·{0}",
    "offset": "Weber with offset, c + w·{0}",
    "power": "power law, w·{0}^p",
}


@dataclasses.dataclass(frozen=True)
class Column:
    """A column of a table: a kind of interval by one method."""

    kind: str
    method: str


@dataclasses.dataclass(frozen=True)
class Line(Generic[R]):
    """A row of a table: one environment, with a record or none under each column."""

    environment: str
    cells: list[R | None]


@dataclasses.dataclass(frozen=True)
class Grid(Generic[R]):
    """A table with a column per kind and method, and a row per environment."""

    columns: list[Column]
    lines: list[Line[R]]
    family: str  # Of its records, in words


def build_sections(results: Results, summary: Findings) -> list[Section]:
    """Return the sections that results have something for, in reading order."""
    sections = (
        first_screen(results, summary),
        intervals(results),
        psychophysics(results),
        contrast(results),
        boundaries(results),
        feelings(results),
        _rendering(results),
        _part(results.coupling, "coupling", "The coupling by the paper"),
        _part(results.design, "design", "Which couplings feel real"),
        device(results),
        band(results),
        comparison(results),
        diagnostics(results),
        checks(results),
        people(results, summary.overview.rows),
        data(results),
        methods(results),
        Section("provenance", "Provenance", _settings(results.provenance.scene)),
        _part(results.skipped, "skipped", "Not computed"),
    )
    return [section for section in sections if section is not None]


def _rendering(results: Results) -> Section | None:
    """Return what the device renders with every passive hand."""
    if not results.rendering:
        return None
    title = "What can be rendered with every hand"
    return Section("rendering", title, rendering_sentences(results))


def _part(part: object, name: str, title: str) -> Section | None:
    """Return a section that shows a part of the results as it stands."""
    return Section(name, title) if part else None


@dataclasses.dataclass(frozen=True)
class Matrix:
    """The intervals of one quantity in the study's family."""

    parameter: str
    title: str
    unit: str
    grid: Grid[IntervalRow]


@dataclasses.dataclass(frozen=True)
class Intervals:
    """The section of intervals."""

    matrices: list[Matrix]
    leaves_out: bool  # Whether adjustments at the limits of a control are left out


def intervals(results: Results) -> Section | None:
    """Return a matrix per quantity in the study's family."""
    if not results.intervals:
        return None
    marginal = matching(results.intervals, joint="marginal")
    matrices = []
    for name in distinct(marginal, "parameter"):
        rows = matching(marginal, parameter=name)
        title = results.data.quantities[name].head
        matrices.append(Matrix(name, title, rows[0].unit, _grid(rows, families_of(results))))
    leaves_out = any(row.left_out for row in results.intervals)
    view = Intervals(matrices, leaves_out)
    return Section("intervals", "Intervals of the adjustments", view)


def _grid(records: Sequence[R], families: Sequence[str]) -> Grid[R]:
    """Put under each column the environment's record of the first family that it has."""
    columns = [Column(rows[0].kind, rows[0].method) for rows in _by_kind_and_method(records)]
    lines = []
    families_shown = set()
    for name in distinct(records, "environment"):
        of_environment = matching(records, environment=name)
        cells = []
        for column in columns:
            candidates = matching(of_environment, kind=column.kind, method=column.method)
            cell = first(candidates, family=families)
            if cell is not None:
                families_shown.add(cell.family)
            cells.append(cell)
        lines.append(Line(name, cells))
    family = ", else ".join(family for family in families if family in families_shown)
    return Grid(columns, lines, family)


def _settings(scene: Mapping[str, Any]) -> list[tuple[str, str, object]]:
    """Return table, key and value of every setting that is not the default."""
    defaults = plain(Scene().to_dict())
    settings = []
    for table, entries in scene.items():
        if not isinstance(entries, Mapping):
            continue
        usual = defaults.get(table) or {}
        for key, value in entries.items():
            if value != usual.get(key):
                settings.append((table, key, value))
    return settings


@dataclasses.dataclass(frozen=True)
class CurveLimits:
    """Limits that the page's script draws; None where a limit is not finite."""

    kind: str
    method: str
    family: str
    shape: str
    grid: int  # Index of its frequencies
    lower: list[float | None]
    upper: list[float | None]


@dataclasses.dataclass(frozen=True)
class Curves:
    """What the page's script draws of one environment; grids that curves share stand once."""

    name: str
    zoom: tuple[float, float] | None  # rad/s
    grids: list[list[float | None]]  # rad/s
    reference: list[float | None]
    coupled: list[float | None] | None
    limits: list[CurveLimits]


@dataclasses.dataclass(frozen=True)
class Boundaries:
    """The section of boundaries."""

    quantities: str
    shapes: dict[str, str]  # What each shape means
    curves: Any  # `Curves` as JSON values
    left_out: str  # Says which environments are not drawn
    device: tuple[float, float] | None  # Least and largest share of the pointwise curves


def boundaries(results: Results) -> Section | None:
    """Return what the shapes mean, and the curves for the page's script."""
    records = results.boundaries
    if not records:
        return None
    names = distinct(records, "environment")
    main = [record for record in records if each_by_itself(record)]
    curves = []
    for name in chosen(names):
        of_environment = matching(main, environment=name)
        if of_environment:
            curves.append(_curves(of_environment, results.zoom.get(name)))
    pointwise = matching(main, shape="pointwise")
    shares = [one.device_share for one in pointwise if one.device_share is not None]
    view = Boundaries(
        quantities=" and ".join(distinct(results.intervals, "parameter")),
        shapes={name: _SHAPES[name] for name in ordered(_SHAPES, records, "shape")},
        curves=plain(curves),
        left_out=choice_said(names, words_of(results).environments),
        device=(min(shares), max(shares)) if shares else None,
    )
    return Section("boundaries", "Realistic performance boundaries", view)


def _curves(records: Sequence[Boundary], zoom: tuple[float, float] | None) -> Curves:
    """Return the curves of one environment to seven digits."""
    grids: list[list[float | None]] = []
    limits = []
    for record in records:
        grid = _short(record.omega)
        if grid not in grids:
            grids.append(grid)
        limits.append(
            CurveLimits(
                kind=record.kind,
                method=record.method,
                family=record.family,
                shape=record.shape,
                grid=grids.index(grid),
                lower=_short(record.lower),
                upper=_short(record.upper),
            )
        )
    reference = records[0].reference
    coupled = records[0].coupled
    return Curves(
        name=records[0].environment,
        zoom=zoom,
        grids=grids,
        reference=_short(reference),
        coupled=None if coupled is None else _short(coupled),
        limits=limits,
    )


def _short(values: Array) -> list[float | None]:
    """Round to seven digits; what is not finite is not drawn."""
    return [float(f"{value:.7g}") if math.isfinite(value) else None for value in values.tolist()]


def device(results: Results) -> Section | None:
    """Return what another mass or damping of the device would change."""
    if results.sensitivity is None:
        return None
    return Section("device", "Another mass or damping of the device")


@dataclasses.dataclass(frozen=True)
class BandPart:
    """The bands of the impedance, or of one quantity, with their laws and statements."""

    name: str  # Of its figure and its table
    size: str  # "impedance" or "reference": what the bands are compared with
    words: str  # Of the quantity
    symbol: str
    unit: str
    family: str
    methods: list[str]
    bands: dict[str, dict[str, BandRow]]  # By environment and method
    laws: dict[str, str]  # Formulas by model
    fitted: dict[str, dict[str, BandLaw]]  # By method and model
    statements: dict[str, list[BandStatement]]  # Of every method, by their sentence


def band(results: Results) -> Section | None:
    """Return how wide the bands are against the impedance, or against references, and the laws."""
    if results.band is None or not results.band.rows:
        return None
    names = distinct(results.band.rows, "parameter")
    parts = []
    for name in names:
        quantity = None if name is None else results.data.quantities[name]
        parts.append(_band_part(results.band, family_of(results), name, quantity))
    size = "impedance" if None in names else "the reference"
    return Section("band", f"Band against {size}", parts)


def _band_part(
    band: Band, family: str, parameter: str | None, quantity: Quantity | None
) -> BandPart:
    """Return the bands of the impedance, or of one parameter, with their laws and statements."""
    rows = matching(band.rows, family=family, parameter=parameter)
    laws = matching(band.laws, family=family, parameter=parameter)
    statements = matching(band.statements, family=family, parameter=parameter)
    symbol = "|Z|" if quantity is None else "reference"
    bands: dict[str, dict[str, BandRow]] = {}
    for row in rows:
        bands.setdefault(row.environment, {})[row.method] = row
    fitted: dict[str, dict[str, BandLaw]] = {}
    for law in laws:
        fitted.setdefault(law.method, {})[law.model] = law
    return BandPart(
        name="band" if parameter is None else f"band_{parameter}",
        size=size_name(parameter),
        words="" if quantity is None else quantity.words,
        symbol=symbol,
        unit="N·s/m" if quantity is None else quantity.unit,
        family=family,
        methods=ordered(METHODS, rows, "method"),
        bands=bands,
        laws={name: _LAWS[name].format(symbol) for name in distinct(laws, "model")},
        fitted=fitted,
        statements={
            sentence: matching(statements, statement=sentence)
            for sentence in distinct(statements, "statement")
        },
    )


def _by_kind_and_method(records: Iterable[Any]) -> list[list[Any]]:
    """Group records by kind and method, in the order of the page."""
    groups = []
    for kind in KINDS:
        for method in METHODS:
            group = matching(records, kind=kind, method=method)
            if group:
                groups.append(group)
    return groups
