"""The figures of boundaries that a document gives."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from percept.report.figures.boundaries import Limits, draw_magnitude, draw_ratio, refined
from percept.report.figures.canvas import Drawing, legend_below, panels, plain_text
from percept.report.select import (
    KINDS,
    METHOD_NAMES,
    METHODS,
    array,
    distinct,
    each_by_itself,
    family_of,
    first,
    matching,
)

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["boundary_drawings"]

FloatArray = NDArray[np.float64]
_KIND_NAMES = {"mean": "average user", "user": "next user", "share": "share of users"}


@dataclass(frozen=True, eq=False)
class _Curves:
    """What one environment shows."""

    environment: str
    omega: FloatArray
    reference: FloatArray
    coupled: FloatArray | None
    paper: list[Limits]
    by_kind: dict[str, list[Limits]]


def boundary_drawings(document: Mapping[str, Any]) -> list[Drawing]:
    """Return three figures per environment: whole range, close view, every kind over the reference.

    Parameters
    ----------
    document : mapping

    Returns
    -------
    list of Drawing
        Numbered in the order of the environments, whose names are text of the input.
    """
    found = []
    for index, environment in enumerate(distinct(document["boundaries"], "environment"), start=1):
        curves = _unpacked(document, environment)
        coupling = " and the reference through the coupling" if curves.coupled is not None else ""
        found.append(
            Drawing(
                f"boundary_{index}_range",
                f"{environment}: boundary of |Z_h| over the whole range",
                f"Limits that feel like {environment} to the average user, the reference{coupling}; on this "
                "scale the curves can hardly be told apart.",
                (85.0, 74.0),
                partial(_draw_range, curves),
            )
        )
        window = _inside(document["zoom"][environment], curves.omega)
        if window is not None:
            found.append(
                Drawing(
                    f"boundary_{index}_zoom",
                    f"{environment}: close view, {window[0]:g} to {window[1]:g} rad/s",
                    f"The same limits, the reference{coupling}, on linear axes.",
                    (85.0, 74.0),
                    partial(_draw_zoom, curves, window),
                )
            )
        found.append(
            Drawing(
                f"boundary_{index}_ratio",
                f"{environment}: limits divided by the reference's |Z_h|",
                "Both methods in one family and one shape for each kind. Dashed, at 1: the reference"
                + ("; dotted: the reference through the coupling." if coupling else "."),
                (175.0, 64.0),
                partial(_draw_ratios, curves),
            )
        )
    return found


def _unpacked(document: Mapping[str, Any], environment: str) -> _Curves:
    rows = [row for row in matching(document["boundaries"], environment=environment) if each_by_itself(row)]
    by_kind = {kind: _like_limits(rows, kind, family_of(document)) for kind in KINDS}
    coupled = rows[0].get("coupled")
    return _Curves(
        environment=environment,
        omega=array(rows[0]["omega"]),
        reference=array(rows[0]["reference"]),
        coupled=array(coupled) if coupled is not None else None,
        paper=_paper_limits(rows),
        by_kind={kind: limits for kind, limits in by_kind.items() if limits},
    )


def _inside(window: list[float], omega: FloatArray) -> tuple[float, float] | None:
    low, high = max(window[0], float(omega[0])), min(window[1], float(omega[-1]))
    return (low, high) if low < high else None


def _paper_limits(rows: list[Any]) -> list[Limits]:
    """Return the paper's corner curves, and the Bayesian curves of the same kind."""
    chosen = (
        ("bayesian", ("lognormal", "normal"), ("pointwise", "envelope", "corner")),
        ("classical", ("normal", "lognormal"), ("corner", "envelope")),
    )
    found = [
        first(matching(rows, method=method), kind=KINDS, family=families, shape=shapes)
        for method, families, shapes in chosen
    ]
    return [_limits(row) for row in found if row is not None]


def _like_limits(rows: list[Any], kind: str, family: str) -> list[Limits]:
    """Return the boundaries of both methods in one family and one shape."""
    candidates = matching(rows, kind=kind)
    families = (family, "normal" if family == "lognormal" else "lognormal")
    for shape in ("envelope", "pointwise", "corner"):
        found = [
            first(matching(candidates, method=method, shape=shape), family=families) for method in METHODS
        ]
        if any(found):
            limits = [_limits(row) for row in reversed(found) if row is not None]
            # One legend serves all kinds.
            return [replace(one, label=one.label.replace(f" {kind},", "")) for one in limits]
    return []


def _limits(row: Mapping[str, Any]) -> Limits:
    label = f"{METHOD_NAMES[row['method']]} {row['kind']}, {row['shape']} ({row['family']})"
    return Limits(label, row["method"], array(row["lower"]), array(row["upper"]))


def _draw_range(curves: _Curves, figure: Figure) -> None:
    (ax,) = panels(figure, bottom=28)
    draw_magnitude(ax, curves.omega, curves.paper, curves.reference, curves.coupled)
    ax.set_title(plain_text(curves.environment), loc="left")
    legend_below(ax, columns=1)


def _draw_zoom(curves: _Curves, window: tuple[float, float], figure: Figure) -> None:
    def close(curve: FloatArray) -> FloatArray:
        return refined(curves.omega, curve, window)

    near = (curves.omega >= window[0] / 2) & (curves.omega <= window[1] * 2)
    limits = [
        Limits(one.label, one.method, close(one.lower), close(one.upper))
        for one in curves.paper
        if (one.lower[near] > 0).all() and np.isfinite(one.upper[near]).all()
    ]
    coupled = close(curves.coupled) if curves.coupled is not None else None
    (ax,) = panels(figure, bottom=28)
    draw_magnitude(ax, np.linspace(*window, 121), limits, close(curves.reference), coupled, log=False)
    ax.set_title(plain_text(f"{curves.environment}, {window[0]:g} to {window[1]:g} rad/s"), loc="left")
    legend_below(ax, columns=1)


def _draw_ratios(curves: _Curves, figure: Figure) -> None:
    axes = panels(figure, columns=len(curves.by_kind), bottom=20)
    for ax, (kind, limits) in zip(axes, curves.by_kind.items(), strict=True):
        draw_ratio(ax, curves.omega, limits, curves.reference, curves.coupled)
        ax.set_title(plain_text(f"{curves.environment}, {kind}: {_KIND_NAMES[kind]}"), loc="left")
    axes[0].set_ylabel("|Z$_h$| / reference")
    legend_below(axes[0], columns=2)
