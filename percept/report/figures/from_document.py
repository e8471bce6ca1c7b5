"""A document to arrays: every figure it has data for."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from functools import partial
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from percept.report.figures.canvas import Drawing, legend_below, panels, row_labels
from percept.report.figures.from_curves import boundary_drawings, stability_drawings
from percept.report.figures.marks import Bar, Widths, beyond_range, draw_band, draw_design, draw_intervals
from percept.report.select import (
    KINDS,
    METHOD_NAMES,
    METHODS,
    Record,
    array,
    distinct,
    families_of,
    first,
    matching,
    quantities_of,
)

FloatArray = NDArray[np.float64]
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
_MAP_TITLE = 38.0  # width, mm
_MAP_COLUMNS = 3


def drawings(document: Record) -> list[Drawing]:
    """Return every figure of a document in the order of the page; nothing is drawn yet."""
    return [
        *overview_drawings(document),
        *interval_drawings(document),
        *boundary_drawings(document),
        *stability_drawings(document["coupling"]),
        *design_drawings(document),
        *_band_drawings(document),
    ]


def overview_drawings(document: Record) -> list[Drawing]:
    """Return the figure of the first screen, a panel per quantity: the average and the next user."""
    intervals = matching(document["intervals"], joint="marginal")
    bars = {name: bars_of(document, name, ("mean", "user")) for name in distinct(intervals, "parameter")}
    bars = {name: some for name, some in bars.items() if some}
    environments = distinct(intervals, "environment")
    families = families_of(document)
    both = len({bar.method for some in bars.values() for bar in some}) == 2

    def panel(name: str, figure: Figure) -> None:
        labels, width = row_labels(environments, most=_MOST_MARGIN / 2)
        (ax,) = panels(figure, left=max(12.0, width + _MARGIN_BESIDE), bottom=21)
        draw_intervals(ax, environments, bars[name], [], log=families[0] == "lognormal", labels=labels)
        ax.set_title(quantities_of(document)[name].head, loc="left")
        ax.set_xlabel("adjusted / reference")
        legend_below(ax)

    description = (
        "Thick: the average user, with a mark at the estimate. Thin: the next user."
        + (" Each classical bar stands above the Bayesian one." if both else "")
        + f" Dashed: the reference.{_classical(intervals, families)}{_cut(bars.values())}"
    )
    size = (86.0, 30.0 + (9.0 if both else 6.5) * len(environments))
    title = "What users set, divided by the reference"
    return [Drawing(f"overview_{name}", title, description, size, partial(panel, name)) for name in bars]


def _cut(groups: Iterable[Sequence[Bar]]) -> str:
    """Say that an arrow ends a bar, where one does."""
    return " An arrow with a value ends a bar that leaves the axis." * any(
        beyond_range(bars) for bars in groups
    )


def interval_drawings(document: Record) -> list[Drawing]:
    """Return one figure per parameter: every kind and method in the study's family, over the reference."""
    figures = (
        _interval_drawing(document, parameter) for parameter in distinct(document["intervals"], "parameter")
    )
    return [drawing for drawing in figures if drawing is not None]


def bars_of(document: Record, parameter: str, kinds: Sequence[str]) -> list[Bar]:
    """Return the bars of a quantity in the study's family, or in the other where it has none."""
    rows = matching(document["intervals"], parameter=parameter, joint="marginal")
    families = families_of(document)
    return [
        bar
        for environment in distinct(rows, "environment")
        for kind in kinds
        for method in METHODS
        if (row := first(matching(rows, environment=environment, kind=kind, method=method), family=families))
        and (bar := _bar(row)) is not None
    ]


def _interval_drawing(document: Record, parameter: str) -> Drawing | None:
    rows = matching(document["intervals"], parameter=parameter, joint="marginal")
    environments = distinct(rows, "environment")
    families, bars = families_of(document), bars_of(document, parameter, KINDS)
    if not bars:
        return None
    values = [values_of(document, environment, parameter) for environment in environments]
    name, log = quantities_of(document)[parameter].words, families[0] == "lognormal"
    subject = document["data"]["words"]["subject"][0]

    def draw(figure: Figure) -> None:
        labels, width = row_labels(environments, most=_MOST_MARGIN / 2)
        (ax,) = panels(figure, left=max(12.0, width + _MARGIN_BESIDE), top=3, bottom=25)
        draw_intervals(ax, environments, bars, values, log=log, labels=labels, subject=subject)
        ax.set_xlabel(f"adjusted {name} / reference")
        legend_below(ax)

    return Drawing(
        f"intervals_{parameter}",
        f"Intervals of {name}, divided by the reference",
        _interval_caption(rows, bars, values, families) + _cut([bars]),
        (86.0, 32.0 + 13.0 * len(environments)),
        draw,
    )


def _bar(row: Record) -> Bar | None:
    if not row.get("reference") or row["lower"] is None or row["upper"] is None:
        return None
    lower, upper, estimate = (float(row[name]) / row["reference"] for name in ("lower", "upper", "estimate"))
    return Bar(row["environment"], row["kind"], row["method"], lower, upper, estimate)


def values_of(document: Record, environment: str, parameter: str) -> FloatArray:
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
            f"({METHOD_NAMES[best['method']]}, {design['family']}), by |Z_h| and by effective stiffness and "
            "damping, at every ω, to 0.1 %." + (f" {said[0].upper()}{said[1:]}." if said else ""),
            (175.0, 16.0 + 52.0 * -(-len(environments) // _MAP_COLUMNS)),
            draw,
        )
    ]


def _band_drawings(document: Record) -> list[Drawing]:
    """Return a figure of bands and laws for the impedance, or for each parameter."""
    rows = (document["band"] or {}).get("rows") or ()
    return [
        _band_drawing(document, parameter) for parameter in dict.fromkeys(r.get("parameter") for r in rows)
    ]


def band_series(
    document: Record, parameter: str | None
) -> tuple[str, FloatArray, list[Widths], dict[str, str]]:
    """Return the first kind there is, sizes for laws, bands in the study's family, and words of the axes."""
    band = document["band"]
    rows = matching(band["rows"], parameter=parameter)
    kind = next(kind for kind in KINDS if matching(rows, kind=kind))
    sizes = array([row[_size(row)] for row in rows])
    grid = np.geomspace(sizes.min() / 1.5, sizes.max() * 1.5, 80)
    families = families_of(document)
    series = [
        _widths(band, row, grid)
        for method in METHODS
        if (row := first(matching(rows, method=method, kind=kind), family=families))
    ]
    if parameter is None:
        return kind, grid, series, {"axis": "environment impedance |Zₑ|", "unit": "N·s/m"}
    quantity = quantities_of(document)[parameter]
    return kind, grid, series, {"axis": f"reference {quantity.words}", "unit": quantity.unit}


def _band_drawing(document: Record, parameter: str | None) -> Drawing:
    """Return the figure of bands and laws."""
    band = document["band"]
    kind, grid, series, words = band_series(document, parameter)
    name, title = "band", f"Band against impedance, kind {kind}"
    said = f"abs(Z_e) against the environment's own impedance at {band['omega'] or 0.0:g} rad/s"
    if parameter is not None:
        quantity = quantities_of(document)[parameter]
        name, title = f"band_{parameter}", f"Band of {quantity.words} against its reference, kind {kind}"
        said = f"{quantity.label} against its reference"

    def draw(figure: Figure) -> None:
        entries = sum(1 + len(widths.laws) for widths in series)
        (ax,) = panels(figure, left=16, top=3, bottom=13 + 4.2 * -(-entries // 2))
        draw_band(ax, grid, series, **words)
        legend_below(ax)

    with_laws = ", with the fitted laws" if any(widths.laws for widths in series) else ""
    caption = f"Width of the band of {said}{with_laws}. The numbers are in the table."
    return Drawing(name, title, caption, (120.0, 80.0), draw)


def _size(row: Record) -> str:
    """Name what a band lies against."""
    return "impedance" if row.get("parameter") is None else "reference"


def _widths(band: Record, like: Record, grid: FloatArray) -> Widths:
    """Return the bands and laws of the same method, kind and family as a row."""
    labels: dict[str, Any] = {name: like.get(name) for name in ("method", "kind", "family", "parameter")}
    rows = matching(band["rows"], **labels)
    return Widths(
        label=f"{METHOD_NAMES[like['method']]} ({like['family']})",
        method=like["method"],
        environments=tuple(row["environment"] for row in rows),
        size=array([row[_size(row)] for row in rows]),
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
