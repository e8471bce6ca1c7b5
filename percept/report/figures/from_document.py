"""A document to arrays: every figure it has data for."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from percept.errors import counted
from percept.report.figures.canvas import Drawing, legend_below, panels, row_labels
from percept.report.figures.curves import (
    SHOWN_RATIOS,
    Limits,
    beyond_axis,
    draw_magnitude,
    draw_ratio,
    draw_stability,
)
from percept.report.figures.marks import Bar, Widths, draw_band, draw_design, draw_intervals
from percept.report.select import (
    KINDS,
    METHOD_NAMES,
    METHODS,
    Record,
    array,
    distinct,
    each_by_itself,
    families_of,
    first,
    matching,
)

FloatArray = NDArray[np.float64]
_PARAMETERS = {"k": "stiffness k", "b": "damping b"}
_KINDS = {"mean": "average user", "user": "next user", "share": "share of users"}
_WHOM = {"mean": "the average user", "user": "the next user", "share": "a share of all users"}
_BARS = {
    "mean": "average user (thick bar, mark at the estimate)",
    "user": "next user",
    "share": "share of users (thin)",
}
_LAWS = {"weber": "Weber", "offset": "Weber with offset", "power": "power law"}
# Left margin of intervals, mm: at least that of short names, at most what leaves the bars half of the width.
_LEAST_MARGIN, _MOST_MARGIN = 18.0, 52.0
# Between a label and the axis, and to the edge of the figure, mm; other viewers' lettering may be wider.
_MARGIN_BESIDE = 4.0
_BOUNDARY_TITLE, _MAP_TITLE = 62.0, 38.0  # widths, mm
_MAP_COLUMNS = 3


def drawings(document: Record) -> list[Drawing]:
    """Return every figure of a document in the order of the page; nothing is drawn yet."""
    return [
        *interval_drawings(document),
        *boundary_drawings(document),
        *_stability_drawings(document["coupling"]),
        *design_drawings(document),
        *_band_drawings(document),
    ]


def interval_drawings(document: Record) -> list[Drawing]:
    """Return one figure per parameter: every kind and method in the study's family, over the reference."""
    figures = (
        _interval_drawing(document, parameter) for parameter in distinct(document["intervals"], "parameter")
    )
    return [drawing for drawing in figures if drawing is not None]


def _interval_drawing(document: Record, parameter: str) -> Drawing | None:
    rows = matching(document["intervals"], parameter=parameter, joint="marginal")
    environments = distinct(rows, "environment")
    families = families_of(document)
    bars = [
        bar
        for environment in environments
        for kind in KINDS
        for method in METHODS
        if (row := first(matching(rows, environment=environment, kind=kind, method=method), family=families))
        and (bar := _bar(row)) is not None
    ]
    if not bars:
        return None
    values = [_values(document, environment, parameter) for environment in environments]
    name, log = _PARAMETERS[parameter], families[0] == "lognormal"

    def draw(figure: Figure) -> None:
        labels, width = row_labels(environments, most=_MOST_MARGIN - _MARGIN_BESIDE)
        (ax,) = panels(figure, left=max(_LEAST_MARGIN, width + _MARGIN_BESIDE), top=3, bottom=21)
        draw_intervals(ax, environments, bars, values, log=log, labels=labels)
        ax.set_xlabel(f"adjusted {name} / reference")
        legend_below(ax, columns=4)

    return Drawing(
        f"intervals_{parameter}",
        f"Intervals of {name}, divided by the reference",
        _interval_caption(rows, bars, values, families),
        (130.0, 26.0 + 17.0 * len(environments)),
        draw,
    )


def _bar(row: Record) -> Bar | None:
    if not row.get("reference") or row["lower"] is None or row["upper"] is None:
        return None
    lower, upper, estimate = (float(row[name]) / row["reference"] for name in ("lower", "upper", "estimate"))
    return Bar(row["environment"], row["kind"], row["method"], lower, upper, estimate)


def _values(document: Record, environment: str, parameter: str) -> FloatArray:
    """Return what each subject adjusted over the reference."""
    cells = matching(document["data"]["cells"], environment=environment, parameter=parameter)
    if not cells or not cells[0]["reference"]:
        return np.empty(0)
    return array(cells[0]["values"]) / cells[0]["reference"]


def _interval_caption(
    rows: list[Record], bars: list[Bar], values: list[FloatArray], families: Sequence[str]
) -> str:
    kinds = [text for kind, text in _BARS.items() if any(bar.kind == kind for bar in bars)]
    order = "In each environment from top to bottom: " + ", ".join(kinds)
    if len({bar.method for bar in bars}) == 2:
        order += "; each classical above Bayesian"
    if any(subjects.size for subjects in values):
        order += "; below them the subjects"
    empty = distinct(matching(rows, reference=0), "environment")
    left_out = f" Only in the tables, since their reference is 0: {', '.join(empty)}." if empty else ""
    return f"{order}. The dashed line is the reference.{_classical(rows, families)}{left_out}"


def _classical(rows: list[Record], families: Sequence[str]) -> str:
    """Say of which family the classical limits are: they are worked out in both."""
    classical = matching(rows, method="classical")
    present = {
        first(matching(classical, environment=name), family=families)["family"]  # type: ignore[index]
        for name in distinct(classical, "environment")
    }
    said = ", where there are none ".join(family for family in families if family in present)
    return f" Classical limits are {said}." if said else ""


def boundary_drawings(document: Record) -> list[Drawing]:
    """Return three figures per environment: whole range, close view, every kind over the reference."""
    return [
        drawing
        for index, environment in enumerate(distinct(document["boundaries"], "environment"), start=1)
        for drawing in _boundary_views(document, environment, f"boundary_{index}")
    ]


def _boundary_views(document: Record, environment: str, name: str) -> list[Drawing]:
    rows = [row for row in matching(document["boundaries"], environment=environment) if each_by_itself(row)]
    coupled = rows[0].get("coupled") is not None
    coupling = " and the reference through the coupling" if coupled else ""
    whom = next(_WHOM[kind] for kind in KINDS if matching(rows, kind=kind))
    limits = _paper_limits(rows)
    views = [
        Drawing(
            f"{name}_range",
            f"{environment}: boundary of |Z_h| over the whole range",
            f"Limits that feel like {environment} to {whom}, with the reference{coupling}."
            + (" On this scale the curves can hardly be told apart." if _close(limits) else ""),
            (85.0, 74.0),
            lambda figure: _draw_curves(figure, rows[0], limits, environment, log=True),
        )
    ]
    near = matching(document["close"], environment=environment)
    if near:
        low, high = document["zoom"][environment]
        window = f"{low:g} to {high:g} rad/s"
        views.append(
            Drawing(
                f"{name}_zoom",
                f"{environment}: close view, {window}",
                f"The same limits, the reference{coupling}, on linear axes.",
                (85.0, 74.0),
                lambda figure: _draw_curves(
                    figure, near[0], _paper_limits(near), f"{environment}, {window}", log=False
                ),
            )
        )
    by_kind = {kind: alike for kind in KINDS if (alike := _like_limits(rows, kind, families_of(document)))}
    views.append(
        Drawing(
            f"{name}_ratio",
            f"{environment}: limits divided by the reference's |Z_h|",
            "One family and one shape for each kind. Dashed, at 1: the reference"
            + ("; dotted: the reference through the coupling." if coupled else ".")
            + _cut(by_kind),
            (175.0, 64.0),
            lambda figure: _draw_ratios(figure, rows[0], by_kind),
        )
    )
    return views


def _close(limits: list[Limits]) -> bool:
    """Say whether every limit lies within a fifth of the reference."""
    return all(
        np.abs(np.log(np.maximum(curve, np.finfo(float).tiny) / pair.reference)).max() < np.log(1.2)
        for pair in limits
        for curve in (pair.lower, pair.upper)
    )


def _cut(by_kind: Mapping[str, list[Limits]]) -> str:
    """Say where axes end before the curves do."""
    cut = [kind for kind, limits in by_kind.items() if beyond_axis(limits)]
    least, most = SHOWN_RATIOS
    where = f"below {least:g} and above {most:g}: {', '.join(cut)}"
    return f" Cut off {where}; boundaries.csv has all of it." if cut else ""


def _paper_limits(rows: list[Record]) -> list[Limits]:
    """Return the paper's corner curves, and the Bayesian curves of the same kind."""
    preferred = (
        ("bayesian", ("lognormal", "normal"), ("pointwise", "envelope", "corner")),
        ("classical", ("normal", "lognormal"), ("corner", "envelope")),
    )
    chosen = [
        first(matching(rows, method=method), kind=KINDS, family=families, shape=shapes)
        for method, families, shapes in preferred
    ]
    return [_limits(row) for row in chosen if row is not None]


def _like_limits(rows: list[Record], kind: str, families: Sequence[str]) -> list[Limits]:
    """Return the boundaries of both methods in one family and one shape."""
    for shape in ("envelope", "pointwise", "corner"):
        alike = matching(rows, kind=kind, shape=shape)
        chosen = [first(matching(alike, method=method), family=families) for method in reversed(METHODS)]
        if any(chosen):
            limits = [_limits(row) for row in chosen if row is not None]
            # One legend serves all kinds.
            return [replace(pair, label=pair.label.replace(f" {kind},", "")) for pair in limits]
    return []


def _limits(row: Record) -> Limits:
    label = f"{METHOD_NAMES[row['method']]} {row['kind']}, {row['shape']} ({row['family']})"
    curves = (array(row[name]) for name in ("omega", "lower", "upper", "reference"))
    return Limits(label, row["method"], *curves)


def _reference(row: Record) -> tuple[FloatArray, FloatArray | None]:
    coupled = row.get("coupled")
    return array(row["reference"]), None if coupled is None else array(coupled)


def _draw_curves(figure: Figure, row: Record, limits: list[Limits], title: str, *, log: bool) -> None:
    (ax,) = panels(figure, right=5, bottom=28)
    draw_magnitude(ax, array(row["omega"]), limits, *_reference(row), log=log)
    ax.set_title(row_labels([title], most=_BOUNDARY_TITLE)[0][0], loc="left")
    legend_below(ax, columns=1)


def _draw_ratios(figure: Figure, row: Record, by_kind: Mapping[str, list[Limits]]) -> None:
    axes = panels(figure, len(by_kind), bottom=20)
    for ax, (kind, limits) in zip(axes, by_kind.items(), strict=True):
        draw_ratio(ax, array(row["omega"]), limits, *_reference(row))
        ax.set_title(f"{kind}: {_KINDS[kind]}", loc="left")
    axes[0].set_ylabel("|Zₕ| / reference")
    legend_below(axes[0], columns=2)


def _stability_drawings(coupling: Record | None) -> list[Drawing]:
    """Return the stability criterion over ω (Fig. 4)."""
    if not coupling or not coupling.get("bound"):
        return []
    label = "this coupling"
    omega, binding = array(coupling["omega"]), coupling["binding_omega"]
    inside = binding is not None and omega[0] <= float(binding) <= omega[-1]

    def draw(figure: Figure) -> None:
        (ax,) = panels(figure, left=18, top=3)
        admittance = {label: array(coupling["admittance"])}
        marks = {label: float(binding)} if inside else None
        draw_stability(ax, omega, array(coupling["bound"]), admittance, binding=marks)

    return [
        Drawing(
            "stability",
            "Stability of the coupling over the angular frequency",
            "Re 1/Z_c of the coupling and the lower bound it has to stay above (Eq. 10).",
            (120.0, 80.0),
            draw,
        )
    ]


def design_drawings(document: Record) -> list[Drawing]:
    """Return the map of couplings that qualify."""
    design, used = document["design"], document["provenance"]["scene"].get("coupling")
    if not design:
        return []
    best = first(design["maps"], method=METHODS[::-1])
    assert best is not None
    environments, edge = best["environments"], design["stable"]

    def draw(figure: Figure) -> None:
        axes = panels(figure, len(environments), columns=_MAP_COLUMNS, bottom=17)
        titles, _ = row_labels([region["name"] or "all together" for region in environments], most=_MAP_TITLE)
        for ax, region, title in zip(axes, environments, titles, strict=True):
            draw_design(
                ax,
                array(best["damping"]),
                [np.array(segments, dtype=float).reshape(-1, 2) for segments in region["intervals"]],
                stable=(array(edge["stiffness"]), array(edge["damping"])) if edge else None,
                coupling=(used["stiffness"], used["damping"]) if used else None,
            )
            ax.set_title(title, loc="left")
        for ax in axes[::_MAP_COLUMNS]:
            ax.set_ylabel("coupling damping (N·s/m)")
        legend_below(max(axes, key=lambda ax: len(ax.get_legend_handles_labels()[0])), columns=3)

    marks = ["the line is the edge of what is stable"] * bool(edge)
    marks += ["the cross is the coupling in use"] * bool(used)
    said = ", ".join(marks)
    return [
        Drawing(
            "design",
            "Couplings that qualify, by environment",
            "Shaded: stable with this device, and inside the next user's boundary "
            f"({METHOD_NAMES[best['method']]}, {design['family']}, envelope), checked at "
            f"{counted(design['frequencies'], 'frequency', 'frequencies')} only."
            + (f" {said[0].upper()}{said[1:]}." if said else ""),
            (175.0, 16.0 + 52.0 * -(-len(environments) // _MAP_COLUMNS)),
            draw,
        )
    ]


def _band_drawings(document: Record) -> list[Drawing]:
    """Return the figure of bands and laws, of the first kind there is, in the study's family."""
    band = document["band"]
    if not band or not band.get("rows"):
        return []
    kind = next(kind for kind in KINDS if matching(band["rows"], kind=kind))
    impedances = array([row["impedance"] for row in band["rows"]])
    grid = np.geomspace(impedances.min() / 1.5, impedances.max() * 1.5, 80)
    families = families_of(document)
    series = [
        _widths(band, row, grid)
        for method in METHODS
        if (row := first(matching(band["rows"], method=method, kind=kind), family=families))
    ]

    def draw(figure: Figure) -> None:
        entries = sum(1 + len(widths.laws) for widths in series)
        (ax,) = panels(figure, left=16, top=3, bottom=13 + 4.2 * -(-entries // 2))
        draw_band(ax, grid, series)
        legend_below(ax)

    with_laws = ", with the fitted laws" if any(widths.laws for widths in series) else ""
    return [
        Drawing(
            "band",
            f"Band against impedance, kind {kind}",
            "Width of the band of abs(Z_e) against the environment's own impedance at "
            f"{band['omega']:g} rad/s{with_laws}. The numbers are in the table.",
            (120.0, 100.0),
            draw,
        )
    ]


def _widths(band: Record, like: Record, grid: FloatArray) -> Widths:
    """Return the bands and laws of the same method, kind and family as a row."""
    labels: dict[str, Any] = {name: like[name] for name in ("method", "kind", "family")}
    rows = matching(band["rows"], **labels)
    return Widths(
        label=f"{METHOD_NAMES[like['method']]} ({like['family']})",
        method=like["method"],
        environments=tuple(row["environment"] for row in rows),
        impedance=array([row["impedance"] for row in rows]),
        band=array([row["band"] for row in rows]),
        laws={
            _LAWS.get(law["model"], str(law["model"])): law_curve(law, grid)
            for law in matching(band["laws"], **labels)
        },
    )


def law_curve(law: Record, impedance: FloatArray) -> FloatArray:
    """Return c + w·abs(Z)^p, with what the law leaves out at its neutral value."""
    values = {name: float(record["value"]) for name, record in law["parameters"].items()}
    return values.get("c", 0.0) + values.get("w", 1.0) * impedance ** values.get("p", 1.0)
