"""The figures of boundaries that a document gives."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from percept.report.figures.boundaries import SHOWN_RATIOS, Limits, beyond_axis, draw_magnitude, draw_ratio
from percept.report.figures.canvas import Drawing, Figure, legend_below, panels, row_labels
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

FloatArray = NDArray[np.float64]
_KIND_NAMES = {"mean": "average user", "user": "next user", "share": "share of users"}
_WHOM = {"mean": "the average user", "user": "the next user", "share": "a share of all users"}
_TITLE_WIDTH = 62.0  # mm


@dataclass(frozen=True, eq=False)
class _Curves:
    """What one environment shows over one range."""

    omega: FloatArray
    reference: FloatArray
    coupled: FloatArray | None
    limits: list[Limits]


def boundary_drawings(document: Mapping[str, Any]) -> list[Drawing]:
    """Return three figures per environment: whole range, close view, every kind over the reference."""
    found = []
    family = family_of(document)
    for index, environment in enumerate(distinct(document["boundaries"], "environment"), start=1):
        rows = [
            row for row in matching(document["boundaries"], environment=environment) if each_by_itself(row)
        ]
        whole = _curves(rows)
        coupling = " and the reference through the coupling" if whole.coupled is not None else ""
        found.append(
            Drawing(
                f"boundary_{index}_range",
                f"{environment}: boundary of |Z_h| over the whole range",
                f"Limits that feel like {environment} to {_whom(rows)}, with the reference{coupling}."
                + (" On this scale the curves can hardly be told apart." if _close(whole) else ""),
                (85.0, 74.0),
                partial(_draw_curves, whole, environment, True),
            )
        )
        near = matching(document["close"], environment=environment)
        if near:
            low, high = document["zoom"][environment]
            found.append(
                Drawing(
                    f"boundary_{index}_zoom",
                    f"{environment}: close view, {low:g} to {high:g} rad/s",
                    f"The same limits, the reference{coupling}, on linear axes.",
                    (85.0, 74.0),
                    partial(_draw_curves, _curves(near), f"{environment}, {low:g} to {high:g} rad/s", False),
                )
            )
        by_kind = {kind: limits for kind in KINDS if (limits := _like_limits(rows, kind, family))}
        found.append(
            Drawing(
                f"boundary_{index}_ratio",
                f"{environment}: limits divided by the reference's |Z_h|",
                "One family and one shape for each kind. Dashed, at 1: the reference"
                + ("; dotted: the reference through the coupling." if coupling else ".")
                + _cut(by_kind),
                (175.0, 64.0),
                partial(_draw_ratios, whole, by_kind),
            )
        )
    return found


def _whom(rows: list[Any]) -> str:
    """Say whom the curves of the whole range are for."""
    (kind, *_) = [kind for kind in KINDS if matching(rows, kind=kind)]
    return _WHOM[kind]


def _cut(by_kind: Mapping[str, list[Limits]]) -> str:
    """Say where axes end before the curves do."""
    cut = [kind for kind, limits in by_kind.items() if beyond_axis(limits)]
    least, most = (f"{ratio:g}" for ratio in SHOWN_RATIOS)
    return (
        f" Cut off below {least} and above {most}: {', '.join(cut)}; boundaries.csv has all of it."
        if cut
        else ""
    )


def _close(curves: _Curves) -> bool:
    """Say whether every limit lies within a fifth of the reference."""
    apart = [
        np.abs(np.log(np.maximum(curve, np.finfo(float).tiny) / one.reference)).max()
        for one in curves.limits
        for curve in (one.lower, one.upper)
    ]
    return max(apart, default=0.0) < np.log(1.2)


def _curves(rows: list[Any]) -> _Curves:
    coupled = rows[0].get("coupled")
    return _Curves(
        omega=array(rows[0]["omega"]),
        reference=array(rows[0]["reference"]),
        coupled=array(coupled) if coupled is not None else None,
        limits=_paper_limits(rows),
    )


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
    curves = (array(row[name]) for name in ("omega", "lower", "upper", "reference"))
    return Limits(label, row["method"], *curves)


def _draw_curves(curves: _Curves, title: str, log: bool, figure: Figure) -> None:
    (ax,) = panels(figure, right=5, bottom=28)
    draw_magnitude(ax, curves.omega, curves.limits, curves.reference, curves.coupled, log=log)
    ax.set_title(row_labels([title], most=_TITLE_WIDTH)[0][0], loc="left")
    legend_below(ax, columns=1)


def _draw_ratios(curves: _Curves, by_kind: Mapping[str, list[Limits]], figure: Figure) -> None:
    axes = panels(figure, columns=len(by_kind), bottom=20)
    for ax, (kind, limits) in zip(axes, by_kind.items(), strict=True):
        draw_ratio(ax, curves.omega, limits, curves.reference, curves.coupled)
        ax.set_title(f"{kind}: {_KIND_NAMES[kind]}", loc="left")
    axes[0].set_ylabel("|Zₕ| / reference")
    legend_below(axes[0], columns=2)
