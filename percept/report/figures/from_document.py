"""A document to arrays: every figure it has data for."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from percept.boundary.band import law_band, size_name
from percept.report.figures.canvas import (
    LETTER,
    WIDE,
    Drawing,
    legend,
    outer_labels,
    panels,
    row_labels,
)
from percept.report.figures.curves import boundary_drawings, stability_drawings
from percept.report.figures.marks import (
    Bar,
    Widths,
    beyond_range,
    design_ends,
    draw_band,
    draw_design,
    draw_intervals,
)
from percept.report.select import (
    KINDS,
    METHOD_NAMES,
    METHODS,
    Record,
    array,
    choice_said,
    chosen,
    compared_by_difference,
    distinct,
    families_of,
    first,
    kind_names,
    matching,
    quantities_of,
)
from percept.sessions.quantities import Quantity

FloatArray = NDArray[np.float64]
_BARS = {
    "mean": "Thick: the average user, with a mark at the estimate",
    "user": "thin: the next user",
    "share": "thinnest: a share of users",
}
_LAWS = {"weber": "Weber", "offset": "Weber with offset", "power": "power law"}
# Left margin of intervals, mm: at least that of short names, at most what leaves the bars half of
# the width.
_LEAST_MARGIN, _MOST_MARGIN = 12.0, 26.0
# Between a label and the axis, and to the edge of the figure, mm; other viewers' lettering may be
# wider.
_MARGIN_BESIDE = 4.0
_COLUMNS = 6  # most panels side by side
_OVERVIEW = ("mean", "user")


def drawings(document: Record) -> list[Drawing]:
    """Return every figure of a document in the order of the page; nothing is drawn yet."""
    return [
        *interval_drawings(document),
        *boundary_drawings(document),
        *stability_drawings(document["coupling"]),
        *design_drawings(document),
        *_band_drawings(document),
    ]


def interval_drawings(document: Record) -> list[Drawing]:
    """Return a figure per quantity: the average and the next user over the reference, and each subject."""
    return [
        _interval_drawing(document, parameter, bars)
        for parameter in distinct(document["intervals"], "parameter")
        if (
            bars := bars_of(document, parameter, ("mean", "user"))
            or bars_of(document, parameter, ("share",))
        )
    ]


def _interval_drawing(document: Record, parameter: str, bars: list[Bar]) -> Drawing:
    rows = matching(document["intervals"], parameter=parameter, joint="marginal")
    every, families = distinct(rows, "environment"), families_of(document)
    environments = chosen(every)
    bars = [bar for bar in bars if bar.environment in environments]
    values = [values_of(document, one, parameter) for one in environments]
    relative = parameter not in compared_by_difference(rows)
    centre = 1.0 if relative else 0.0
    groups = len({(bar.kind, bar.method) for bar in bars})

    def draw(figure: Figure) -> None:
        labels = row_labels(environments, most=_MOST_MARGIN)
        width = LETTER * max(map(len, labels))
        (ax,) = panels(figure, left=max(_LEAST_MARGIN, width + _MARGIN_BESIDE), bottom=20.4)
        log, subject = families[0] == "lognormal", document["data"]["words"]["subject"][0]
        words: dict[str, Any] = {
            "labels": labels,
            "subject": subject,
            "names": kind_names(document),
        }
        draw_intervals(ax, environments, bars, values, log=log and relative, centre=centre, **words)
        quantity = quantities_of(document)[parameter]
        ax.set_title(quantity.head, loc="left")
        ax.set_xlabel(axis_of_bars("adjusted", quantity, relative=relative))
        legend(ax, ncols=3)

    return Drawing(
        f"overview_{parameter}",
        f"What users set, {'divided by' if relative else 'less'} the reference",
        _interval_caption(rows, bars, values, families) + choice_said(every),
        (86.0, 29.0 + (2.8 + 1.7 * groups) * len(environments)),
        draw,
    )


def _interval_caption(
    rows: list[Record], bars: list[Bar], values: list[FloatArray], families: Sequence[str]
) -> str:
    kinds = [text for kind, text in _BARS.items() if any(bar.kind == kind for bar in bars)]
    classical = matching(rows, method="classical")
    present = {
        best["family"]
        for name in distinct(classical, "environment")
        if (best := first(matching(classical, environment=name), family=families))
    }
    of = ", where there are none ".join(family for family in families if family in present)
    relative = not compared_by_difference(rows)
    log = relative and families[0] == "lognormal"
    beyond = beyond_range(bars, log=log, centre=1.0 if relative else 0.0)
    sentences = [
        f"{'; '.join(kinds)}; dashed: the reference",
        "Each classical bar stands above the Bayesian one"
        * (len({bar.method for bar in bars}) == 2),
        "Ticks: the subjects" * any(some.size for some in values),
        f"Classical limits are {of}" if of else "",
        "An arrow with a value ends a bar that leaves the axis" * beyond,
    ]
    return " ".join(f"{sentence}." for sentence in sentences if sentence)


def bars_of(document: Record, parameter: str, kinds: Sequence[str]) -> list[Bar]:
    """Return the bars of a quantity in the study's family, or in the other where it has none."""
    rows = matching(document["intervals"], parameter=parameter, joint="marginal")
    families = families_of(document)
    relative = parameter not in compared_by_difference(rows)
    return [
        bar
        for environment in distinct(rows, "environment")
        for kind in kinds
        for method in METHODS
        if (
            row := first(
                matching(rows, environment=environment, kind=kind, method=method), family=families
            )
        )
        and (bar := _bar(row, relative=relative)) is not None
    ]


def _bar(row: Record, *, relative: bool) -> Bar | None:
    """Return a row's bar; None without reference or limits."""
    reference = row.get("reference")
    if reference is None or row["lower"] is None or row["upper"] is None:
        return None
    ends = [float(row[name]) for name in ("lower", "upper", "estimate")]
    ends = [end / reference if relative else end - reference for end in ends]
    return Bar(row["environment"], row["kind"], row["method"], *ends)


def values_of(document: Record, environment: str, parameter: str) -> FloatArray:
    """Return what each subject adjusted, against the reference as the bars are."""
    of_parameter = matching(document["data"]["cells"], parameter=parameter)
    cells = matching(of_parameter, environment=environment)
    if not cells or cells[0]["reference"] is None:
        return np.empty(0)
    values = array(cells[0]["values"])
    if parameter in compared_by_difference(of_parameter):
        return values - cells[0]["reference"]
    return values / cells[0]["reference"]


def axis_of_bars(start: str, quantity: Quantity, *, relative: bool) -> str:
    """Return the label of the axis that bars are drawn on."""
    if relative:
        return f"{start} / reference"
    unit = f" ({quantity.unit})" if quantity.unit else ""
    return f"{start} − reference{unit}"


def design_drawings(document: Record) -> list[Drawing]:
    """Return the map of couplings that qualify."""
    design, used = document["design"], document["provenance"]["scene"].get("coupling")
    if not design:
        return []
    best = first(design["maps"], method=METHODS[::-1])
    assert best is not None
    edge, damping = design["stable"], array(best["damping"])
    names = [region["name"] for region in best["environments"] if region["name"] is not None]
    drawn = {*chosen(names), None}
    regions = [region for region in best["environments"] if region["name"] in drawn]
    columns = min(max(len(regions), 3), _COLUMNS)

    def draw(figure: Figure) -> None:
        axes = panels(figure, len(regions), columns=columns, bottom=17, gap=3, line=8)
        titles = row_labels([region["name"] or "all together" for region in regions], most=24.0)
        maps = [
            [np.array(some, dtype=float).reshape(-1, 2) for some in r["intervals"]] for r in regions
        ]
        marks: dict[str, Any] = {
            "stable": (array(edge["stiffness"]), array(edge["damping"])) if edge else None,
            "coupling": (used["stiffness"], used["damping"]) if used else None,
        }
        ends = design_ends(damping, maps, **marks)
        for ax, segments, title in zip(axes, maps, titles, strict=True):
            draw_design(ax, damping, segments, **marks, ends=ends)
            ax.set_title(title, loc="left")
            ax.set_xlabel("stiffness (kN/m)")
            ax.set_ylabel("damping (N·s/m)")
        outer_labels(axes, columns)
        legend(max(axes, key=lambda ax: len(ax.get_legend_handles_labels()[0])), ncols=3)

    marked = " The line is the edge of what is stable." * bool(edge)
    marked += " The cross is the coupling in use." * bool(used)
    return [
        Drawing(
            "design",
            "Couplings that qualify, by stiffness and damping of the coupling",
            "Shaded: stable with this device, and inside the next user’s boundary"
            f" ({METHOD_NAMES[best['method']]}, {design['family']}), by |Z_h| and by effective"
            f" stiffness and damping, at every ω, to 0.1 %.{marked}{choice_said(names)}",
            (WIDE, 15.0 + 42.0 * -(-len(regions) // columns)),
            draw,
        )
    ]


def _band_drawings(document: Record) -> list[Drawing]:
    """Return a figure of bands and laws for the impedance, or for each parameter."""
    rows = (document["band"] or {}).get("rows") or ()
    return [
        _band_drawing(document, parameter)
        for parameter in dict.fromkeys(r.get("parameter") for r in rows)
    ]


def band_series(
    document: Record, parameter: str | None
) -> tuple[str, FloatArray, list[Widths], dict[str, str]]:
    """Return the first kind there is, sizes for laws, bands in the study's family, and words of the axes."""
    band = document["band"]
    rows = matching(band["rows"], parameter=parameter)
    kind = next(kind for kind in KINDS if matching(rows, kind=kind))
    sizes = array([row[size_name(parameter)] for row in rows])
    grid = np.geomspace(sizes.min() / 1.5, sizes.max() * 1.5, 80)
    series = [
        _widths(band, row, grid)
        for method in METHODS
        if (row := first(matching(rows, method=method, kind=kind), family=families_of(document)))
    ]
    if parameter is None:
        return kind, grid, series, {"axis": "environment impedance |Zₑ|", "unit": "N·s/m"}
    quantity = quantities_of(document)[parameter]
    return kind, grid, series, {"axis": f"reference {quantity.words}", "unit": quantity.unit}


def _band_drawing(document: Record, parameter: str | None) -> Drawing:
    """Return the figure of bands and laws."""
    kind, grid, series, words = band_series(document, parameter)
    name, title = "band", "Band against impedance"
    said = (
        f"|Z_e| against the environment’s own impedance at {document['band']['omega'] or 0.0:g}"
        " rad/s"
    )
    if parameter is not None:
        quantity = quantities_of(document)[parameter]
        name, title = f"band_{parameter}", f"Band of {quantity.words} against its reference"
        said = f"{quantity.label} against its reference"

    def draw(figure: Figure) -> None:
        (ax,) = panels(figure, left=16, top=3, right=48)
        draw_band(ax, grid, series, **words)
        legend(ax, loc="center right", ncols=1)

    with_laws = ", with the fitted laws" if any(widths.laws for widths in series) else ""
    return Drawing(
        name,
        f"{title}, {kind_names(document)[kind]}",
        f"Width of the band of {said}{with_laws}.",
        (150.0, 58.0),
        draw,
    )


def _widths(band: Record, like: Record, grid: FloatArray) -> Widths:
    """Return the bands and laws of the same method, kind and family as a row."""
    labels: dict[str, Any] = {
        name: like.get(name) for name in ("method", "kind", "family", "parameter")
    }
    rows, laws = matching(band["rows"], **labels), {}
    for law in matching(band["laws"], **labels):
        values = [float(fitted["value"]) for fitted in law["parameters"].values()]
        laws[_LAWS[law["model"]]] = law_band(law["model"], np.array([values]), grid)[0]
    return Widths(
        label=f"{METHOD_NAMES[like['method']]} ({like['family']})",
        method=like["method"],
        environments=tuple(row["environment"] for row in rows),
        size=array([row[size_name(row.get("parameter"))] for row in rows]),
        band=array([row["band"] for row in rows]),
        laws=laws,
    )
