"""A document to arrays: its curves over the angular frequency."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from percept.report.figures.canvas import Drawing, legend_below, panels, row_labels
from percept.report.figures.curves import Limits, draw_magnitude, draw_ratio, draw_stability, ratio_range
from percept.report.select import (
    KIND_NAMES,
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
_WHOM = {"mean": "the average user", "user": "the next user", "share": "a share of all users"}
_TITLE, _STRIP_TITLE = 38.0, 22.0  # widths, mm
_COLUMNS = 3
_STRIPS = 6  # environments in one figure of ratios
#: The next user's boundary decides what feels real.
_SHOWN_FIRST = ("user", "mean", "share")


def boundary_drawings(document: Record) -> list[Drawing]:
    """Return the boundaries over ω, close views that the scene asks for, and limits over the reference."""
    families = families_of(document)
    rows = {
        name: [row for row in matching(document["boundaries"], environment=name) if each_by_itself(row)]
        for name in distinct(document["boundaries"], "environment")
    }
    if not rows:
        return []
    kind = next(kind for kind in _SHOWN_FIRST if any(matching(some, kind=kind) for some in rows.values()))
    near = {
        name: found
        for name in document["zoom"]
        if (found := matching(document["close"], environment=name, kind=kind))
    }
    drawings = [_curves_drawing("boundaries", rows, kind, families, log=True)]
    if near:
        drawings.append(_curves_drawing("boundaries_close", near, kind, families, log=False))
    names = list(rows)
    groups = [names[start : start + _STRIPS] for start in range(0, len(names), _STRIPS)]
    return drawings + [
        _ratio_drawing({name: rows[name] for name in group}, index if len(groups) > 1 else 0, families)
        for index, group in enumerate(groups, start=1)
    ]


def _curves_drawing(
    name: str, rows: Mapping[str, list[Record]], kind: str, families: Sequence[str], *, log: bool
) -> Drawing:
    """Draw the boundary of each environment in a panel of its own, both methods in one family and shape."""
    limits = {environment: like_limits(some, kind, families) for environment, some in rows.items()}
    shown = next(record for some in rows.values() for record in some)
    coupled = " Dotted: the reference through the coupling." * (shown.get("coupled") is not None)
    shape = next(pair.label for pairs in limits.values() for pair in pairs).partition(", ")[2]

    def draw(figure: Figure) -> None:
        axes = panels(figure, len(rows), columns=_COLUMNS, bottom=17)
        titles, _ = row_labels(list(rows), most=_TITLE)
        for ax, title, (environment, some) in zip(axes, titles, rows.items(), strict=True):
            pairs = limits[environment]
            draw_magnitude(ax, array(some[0]["omega"]), pairs, *reference_of(some[0]), log=log)
            ax.set_title(title, loc="left")
            ax.set_xlabel("ω (rad/s)")
            ax.set_ylabel("")
        for ax in axes[::_COLUMNS]:
            ax.set_ylabel("|Zₕ| (N·s/m)")
        legend_below(axes[0], columns=4)

    return Drawing(
        name,
        f"Boundaries of |Z_h| for {_WHOM[kind]}" + ("" if log else ", close views"),
        f"What {_WHOM[kind]} takes for the reference lies between the limits ({shape}). "
        f"Dashed: the reference.{coupled}",
        (175.0, 16.0 + 52.0 * -(-len(rows) // _COLUMNS)),
        draw,
    )


def _ratio_drawing(rows: Mapping[str, list[Record]], index: int, families: Sequence[str]) -> Drawing:
    """Draw limits over the reference: a row of panels per environment, a column per kind, axes shared."""
    kinds = [kind for kind in KINDS if any(like_limits(some, kind, families) for some in rows.values())]
    cells = {
        (name, kind): pairs
        for name, some in rows.items()
        for kind in kinds
        if (pairs := like_limits(some, kind, families))
    }
    low, high = ratio_range(list(cells.values()))

    def draw(figure: Figure) -> None:
        axes = panels(figure, len(rows) * len(kinds), columns=len(kinds), left=20, bottom=18, gap=4, line=4)
        names, _ = row_labels(list(rows), most=_STRIP_TITLE)
        for position, ax in enumerate(axes):
            line, column = divmod(position, len(kinds))
            name, kind = list(rows)[line], kinds[column]
            row = rows[name][0]
            draw_ratio(
                ax, array(row["omega"]), cells.get((name, kind), []), *reference_of(row), limits=(low, high)
            )
            if line == 0:
                ax.set_title(f"{kind}: {KIND_NAMES[kind]}", loc="left")
            if line < len(rows) - 1:
                ax.tick_params(labelbottom=False)
                ax.set_xlabel("")
            if column:
                ax.tick_params(labelleft=False)
            else:
                ax.set_ylabel(names[line])
        legend_below(axes[0], columns=4)

    coupled = any(row.get("coupled") is not None for some in rows.values() for row in some)
    return Drawing(
        f"ratios_{index}" if index else "ratios",
        "Limits divided by the reference’s |Z_h|",
        "One family and one shape for each kind. Dashed, at 1: the reference"
        + ("; dotted: the reference through the coupling." if coupled else ".")
        + " An arrow with a value marks a curve that leaves the axis.",
        (175.0, 24.0 + 22.0 * len(rows)),
        draw,
    )


def like_limits(rows: list[Record], kind: str, families: Sequence[str]) -> list[Limits]:
    """Return the boundaries of both methods in one family and one shape."""
    for shape in ("envelope", "pointwise"):
        alike = matching(rows, kind=kind, shape=shape)
        chosen = [first(matching(alike, method=method), family=families) for method in reversed(METHODS)]
        if any(chosen):
            limits = [_limits(row) for row in chosen if row is not None]
            # One legend serves all kinds.
            return [replace(pair, label=pair.label.replace(f" {kind},", ",")) for pair in limits]
    return []


def _limits(row: Record) -> Limits:
    label = f"{METHOD_NAMES[row['method']]} {row['kind']}, {row['shape']} ({row['family']})"
    curves = (array(row[name]) for name in ("omega", "lower", "upper", "reference"))
    return Limits(label, row["method"], *curves)


def reference_of(row: Record) -> tuple[FloatArray, FloatArray | None]:
    """Return a boundary's reference, and it through the coupling where there is one."""
    coupled = row.get("coupled")
    return array(row["reference"]), None if coupled is None else array(coupled)


def stability_drawings(coupling: Record | None) -> list[Drawing]:
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
            (120.0, 62.0),
            draw,
        )
    ]
