"""Curves over the angular frequency, as in Figs 4 and 7: arrays to axes, then a document to arrays."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import cycle
from typing import Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator
from numpy.typing import ArrayLike, NDArray

from percept.report.figures.canvas import (
    COLOURS,
    WIDE,
    Drawing,
    brief,
    common_range,
    legend,
    log_scale,
    mark,
    outer_labels,
    panels,
    row_labels,
)
from percept.report.select import (
    KINDS,
    METHOD_NAMES,
    METHODS,
    Record,
    array,
    choice_said,
    chosen,
    distinct,
    each_by_itself,
    families_of,
    first,
    kind_names,
    matching,
)

FloatArray = NDArray[np.float64]
_REFERENCE = (0, (7, 3))
_COUPLED = (0, (2.5, 1.5))
# Long and short dashes as in the paper's Fig. 4; more couplings go on with other patterns.
_COLOURS = ("classical", "bayesian", "coupled", "warn")
_DASHES = ((0, (9, 3)), (0, (3, 2)), (0, (6, 2, 1, 2)), (0, (1, 1.5)))


@dataclass(frozen=True, eq=False)
class Limits:
    """A pair of curves to draw."""

    label: str  # For the legend
    method: str  # Decides colour and form: classical limits are lines, Bayesian ones a filled band
    omega: FloatArray  # (n,) rad/s
    lower: FloatArray  # (n,) N·s/m
    upper: FloatArray  # (n,) N·s/m
    reference: FloatArray  # (n,) abs(Z_h) of the reference at the same ω, N·s/m


def draw_magnitude(
    ax: Axes,
    omega: FloatArray,
    limits: Sequence[Limits],
    reference: FloatArray,
    coupled: FloatArray | None = None,
    *,
    log: bool = True,
) -> None:
    """Draw boundaries, the reference and the coupled impedance, in the manner of Fig. 7."""
    _draw(ax, omega, limits, reference, coupled)
    if log:
        log_scale(ax, "x", plain=True)
        log_scale(ax, "y")
    else:
        ax.locator_params(nbins=5)
    ax.set_ylabel("|Zₕ| (N·s/m)")


def draw_ratio(
    ax: Axes,
    omega: FloatArray,
    pairs: Sequence[Limits],
    reference: FloatArray,
    coupled: FloatArray | None = None,
    *,
    limits: tuple[float, float],
) -> None:
    """Draw boundaries divided by the reference's abs(Z_h); an arrow marks what leaves the axis."""
    ratios, (low, high) = _ratios(pairs), limits
    _draw(ax, omega, ratios, np.ones_like(omega), None if coupled is None else coupled / reference)
    ax.set_yscale("log", nonpositive="clip")
    log_scale(ax, "x", plain=True)
    ax.minorticks_off()
    # Narrow strips have room for powers of ten alone where the axis is long.
    ax.yaxis.set_major_locator(LogLocator(subs=(1, 2, 5) if high < 30 * low else (1,)))
    ax.yaxis.set_major_formatter("{x:g}")
    ax.set_ylim(low / 1.06, high * 1.06)
    for arrow, y, side, value in (
        ("▲", 0.97, "top", max((float(np.max(pair.upper)) for pair in ratios), default=1.0)),
        ("▼", 0.03, "bottom", min((float(np.min(pair.lower)) for pair in ratios), default=1.0)),
    ):
        if not low <= value <= high:
            place: dict[str, Any] = {"transform": ax.transAxes, "ha": "right", "va": side}
            ax.text(0.98, y, f"{arrow} {brief(value)}", fontsize=6.5, color=COLOURS["ink"], **place)


def ratio_range(groups: Sequence[Sequence[Limits]]) -> tuple[float, float]:
    """Return the common axis of boundaries over their references, each group a panel."""
    ratios = [_ratios(group) for group in groups]
    lows = [min(float(np.min(pair.lower)) for pair in group) for group in ratios]
    highs = [max(float(np.max(pair.upper)) for pair in group) for group in ratios]
    return common_range(lows, highs, log=True)


def _ratios(limits: Sequence[Limits]) -> list[Limits]:
    return [
        replace(pair, lower=pair.lower / pair.reference, upper=pair.upper / pair.reference)
        for pair in limits
    ]


def _draw(
    ax: Axes,
    omega: FloatArray,
    limits: Sequence[Limits],
    reference: FloatArray,
    coupled: FloatArray | None,
) -> None:
    for pair in limits:
        colour, drawn = COLOURS[pair.method], list[Artist]()
        if pair.method == "classical":
            drawn += ax.plot(pair.omega, pair.lower, color=colour, label=pair.label)
            drawn += ax.plot(pair.omega, pair.upper, color=colour)
        else:
            # The corner curves cross; the band between them is what is meant.
            low, high = np.minimum(pair.lower, pair.upper), np.maximum(pair.lower, pair.upper)
            shade: dict[str, Any] = {
                "color": colour,
                "alpha": 0.25,
                "linewidth": 0,
                "label": pair.label,
            }
            drawn.append(ax.fill_between(pair.omega, low, high, **shade))
            drawn += ax.plot(pair.omega, low, color=colour, linewidth=0.6)
            drawn += ax.plot(pair.omega, high, color=colour, linewidth=0.6)
        mark(ax, drawn, pair.method)
    ax.plot(omega, reference, color=COLOURS["ink"], linestyle=_REFERENCE, label="reference, |Zₕ|")
    if coupled is not None:
        label = "reference through the coupling"
        ax.plot(omega, coupled, color=COLOURS["coupled"], linestyle=_COUPLED, label=label)
    ax.set_xlim(omega[0], omega[-1])
    ax.set_xlabel("ω (rad/s)")


def draw_stability(
    ax: Axes,
    omega: ArrayLike,
    bound: ArrayLike,
    couplings: Mapping[str, tuple[ArrayLike, float]],
) -> None:
    """Draw the bound of Eq. 10, and couplings that have to stay above it, each with the ω where it binds."""
    omega, bound = np.asarray(omega, dtype=float), _drawable(bound)
    ax.plot(
        omega, bound, color=COLOURS["ink"], linewidth=1.4, label="lower bound (Eq. 10)", gid="bound"
    )
    styles = zip(cycle(_DASHES), cycle(_COLOURS), strict=False)
    for (label, (values, at)), (dashes, name) in zip(couplings.items(), styles, strict=False):
        curve, colour = _drawable(values), COLOURS[name]
        style: dict[str, Any] = {"color": colour, "linestyle": dashes, "linewidth": 1.4}
        (line,) = ax.plot(omega, curve, label=label, gid=f"coupling:{label}", **style)
        if omega[0] <= at <= omega[-1]:
            reached, needed = (_at(at, omega, values) for values in (curve, bound))
            ax.plot([at], [reached], "o", markersize=6, color=colour, gid=f"binding:{label}")
            ax.axvline(at, color=colour, linewidth=0.7, linestyle=":")
            # In the legend, because the marks of like couplings lie on top of each other.
            line.set_label(f"{label}: {reached / needed:.3g} × bound at {at:.4g} rad/s")
    log_scale(ax)
    ax.set_xlim(omega[0], omega[-1])
    ax.set_xlabel("ω (rad/s)")
    ax.set_ylabel("admittance, real part (m/(N·s))")
    ax.margins(y=0.12)
    ax.legend(frameon=False, loc="upper left")


def _drawable(values: ArrayLike) -> FloatArray:
    """Return a curve with gaps where it is zero or infinite, which have no place on a log axis."""
    curve = np.asarray(values, dtype=float)
    return np.where((curve > 0) & np.isfinite(curve), curve, np.nan)


def _at(frequency: float, omega: FloatArray, values: FloatArray) -> float:
    """Return a curve's value between its points, straight on the log-log axes."""
    kept = np.isfinite(values)
    return float(np.exp(np.interp(np.log(frequency), np.log(omega[kept]), np.log(values[kept]))))


_WHOM = {"mean": "the average user", "user": "the next user", "share": "a share of all users"}
#: The next user's boundary decides what feels real.
_SHOWN_FIRST = ("user", "mean", "share")
_COLUMNS = 5  # most panels side by side
_STRIP_TITLE = 14.0  # width, mm


def boundary_drawings(document: Record) -> list[Drawing]:
    """Return the boundaries over ω, limits over the reference, and close views that the scene asks for."""
    families = families_of(document)
    every = _by_environment(document["boundaries"])
    if not every:
        return []
    rows = {name: every[name] for name in chosen(list(every))}
    left_out = choice_said(list(every))
    kinds = {row["kind"] for some in rows.values() for row in some}
    kind = next(kind for kind in _SHOWN_FIRST if kind in kinds)
    near = _by_environment(matching(document["close"], kind=kind))
    drawings = [
        _curves_drawing("boundaries", rows, kind, families, log=True),
        _ratio_drawing(rows, families, kind_names(document)),
    ]
    drawings = [replace(one, description=one.description + left_out) for one in drawings]
    if near:
        close = {name: near[name] for name in chosen(list(near))}
        drawings.append(_curves_drawing("boundaries_close", close, kind, families, log=False))
    return drawings


def _by_environment(records: Sequence[Record]) -> dict[str, list[Record]]:
    kept = [record for record in records if each_by_itself(record)]
    return {name: matching(kept, environment=name) for name in distinct(kept, "environment")}


def _curves_drawing(
    name: str, rows: Mapping[str, list[Record]], kind: str, families: Sequence[str], *, log: bool
) -> Drawing:
    """Draw the boundary of each environment in a panel of its own; close views have axes of their own."""
    limits = {environment: like_limits(some, kind, families) for environment, some in rows.items()}
    coupled = any(record.get("coupled") is not None for some in rows.values() for record in some)
    shape = next(pair.label for pairs in limits.values() for pair in pairs).partition(", ")[2]
    columns, gap = (min(max(len(rows), 3), _COLUMNS), 6.0 if log else 12.0)

    def draw(figure: Figure) -> None:
        axes = panels(figure, len(rows), columns=columns, bottom=17, gap=gap, line=8 if log else 14)
        titles = row_labels(list(rows), most=(WIDE - 17.0) / columns - gap)
        for ax, title, (environment, some) in zip(axes, titles, rows.items(), strict=True):
            draw_magnitude(
                ax, array(some[0]["omega"]), limits[environment], *reference_of(some[0]), log=log
            )
            ax.set_title(title, loc="left")
        if log:
            ends = np.array([ax.get_ylim() for ax in axes])
            for ax in axes:
                ax.set_ylim(ends.min(), ends.max())
            outer_labels(axes, columns)
        for index, ax in enumerate(axes):
            ax.set_ylabel("" if index % columns else "|Zₕ| (N·s/m)")
        legend(axes[0], ncols=4)

    return Drawing(
        name,
        f"Boundaries of |Z_h| for {_WHOM[kind]}" + ("" if log else ", close views"),
        f"What {_WHOM[kind]} takes for the reference lies between the limits ({shape}). "
        f"Dashed: the reference.{' Dotted: the reference through the coupling.' * coupled}",
        (WIDE, 15.0 + 42.0 * -(-len(rows) // columns)),
        draw,
    )


def _ratio_drawing(
    rows: Mapping[str, list[Record]], families: Sequence[str], names_of_kinds: Mapping[str, str]
) -> Drawing:
    """Draw limits over the reference: a row of panels per environment, a column per kind, axes shared."""
    cells = {
        (name, kind): pairs
        for kind in KINDS
        for name, some in rows.items()
        if (pairs := like_limits(some, kind, families))
    }
    kinds = list(dict.fromkeys(kind for _, kind in cells))
    limits = ratio_range(list(cells.values()))

    def draw(figure: Figure) -> None:
        axes = panels(
            figure, len(rows) * len(kinds), columns=len(kinds), left=20, bottom=17, gap=6, line=2.5
        )
        names = row_labels(list(rows), most=_STRIP_TITLE)
        for position, ax in enumerate(axes):
            line, column = divmod(position, len(kinds))
            name, kind = list(rows)[line], kinds[column]
            row = rows[name][0]
            draw_ratio(
                ax,
                array(row["omega"]),
                cells.get((name, kind), []),
                *reference_of(row),
                limits=limits,
            )
            ax.set_ylabel(names[line])
            if line == 0:
                ax.set_title(f"{kind}: {names_of_kinds[kind]}", loc="left")
        outer_labels(axes, len(kinds))
        legend(axes[0], ncols=4)

    coupled = any(row.get("coupled") is not None for some in rows.values() for row in some)
    return Drawing(
        "ratios",
        "Limits divided by the reference’s |Z_h|",
        "One family and one shape for each kind. Dashed, at 1: the reference"
        + ("; dotted: the reference through the coupling." if coupled else ".")
        + " An arrow with a value marks a curve that leaves the axis.",
        (WIDE, 21.0 + 15.5 * len(rows)),
        draw,
    )


def like_limits(rows: list[Record], kind: str, families: Sequence[str]) -> list[Limits]:
    """Return the boundaries of both methods in one family and one shape."""
    for shape in ("envelope", "pointwise"):
        alike = matching(rows, kind=kind, shape=shape)
        chosen = [
            first(matching(alike, method=method), family=families) for method in reversed(METHODS)
        ]
        if limits := [_limits(row) for row in chosen if row is not None]:
            return limits
    return []


def _limits(row: Record) -> Limits:
    label = f"{METHOD_NAMES[row['method']]}, {row['shape']} ({row['family']})"
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

    def draw(figure: Figure) -> None:
        (ax,) = panels(figure, left=18, top=3)
        omega, bound, admittance = (
            array(coupling[name]) for name in ("omega", "bound", "admittance")
        )
        # JSON has infinity as text.
        draw_stability(
            ax, omega, bound, {"this coupling": (admittance, float(coupling["binding_omega"]))}
        )

    return [
        Drawing(
            "stability",
            "Stability of the coupling over the angular frequency",
            "The real part of the coupling’s admittance 1/Z_c has to stay above the lower bound.",
            (120.0, 50.0),
            draw,
        )
    ]
