"""Which figures a document gives: its records unpacked, named and handed to the drawing functions."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from percept.report.figures.band import Widths, draw_band
from percept.report.figures.boundaries import Limits, draw_magnitude, draw_ratio, refined
from percept.report.figures.canvas import Drawing, plain_text
from percept.report.figures.intervals import KINDS, METHODS, Bar, draw_intervals
from percept.report.figures.stability import draw_stability
from percept.report.select import array, distinct, first, matching

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["drawings"]

Document = Mapping[str, Any]
FloatArray = NDArray[np.float64]

_NAMES = {"k": "stiffness k", "b": "damping b"}
_KIND_NAMES = {"mean": "average user", "user": "next user", "share": "share of users"}
_LAW_NAMES = {"weber": "Weber", "offset": "Weber with offset", "power": "power"}


def drawings(document: Document) -> dict[str, Drawing]:
    """Return every figure the document has data for, by name, in the order of the page.

    Parameters
    ----------
    document : mapping
        As `percept.report.document.build_document` returns it.

    Returns
    -------
    dict
        Name to Drawing; nothing is drawn yet.
    """
    found = [*_intervals(document), *_boundaries(document), *_band(document), *_stability(document)]
    return {drawing.name: drawing for drawing in found}


def family_of(document: Document) -> str:
    """Return the family of the study's own model."""
    scene = document["provenance"]["scene"]
    return str(scene.get("inference", {}).get("family", "lognormal"))


def _intervals(document: Document) -> list[Drawing]:
    family = family_of(document)
    found = []
    for parameter in distinct(document["intervals"], "parameter"):
        rows = matching(document["intervals"], parameter=parameter)
        environments = distinct(rows, "environment")
        bars = []
        for environment in environments:
            for kind in KINDS:
                for method in METHODS:
                    row = first(
                        matching(rows, environment=environment, kind=kind, method=method, joint="marginal"),
                        family=(family, "normal", "lognormal"),
                    )
                    if row is None or not row.get("reference") or row["lower"] is None:
                        continue
                    limits = [float(row[name]) / row["reference"] for name in ("lower", "upper", "estimate")]
                    bars.append(Bar(environment, kind, method, *limits))
        if not bars:
            continue
        cells = {
            cell["environment"]: array(cell["values"]) / cell["reference"]
            for cell in matching(document["data"]["cells"], parameter=parameter)
            if cell["reference"]
        }
        values = [cells.get(environment, np.empty(0)) for environment in environments]

        def draw(
            figure: Figure,
            *,
            environments: list[str] = environments,
            bars: list[Bar] = bars,
            values: list[FloatArray] = values,
            name: str = _NAMES[parameter],
        ) -> None:
            ax = figure.add_subplot()
            draw_intervals(ax, environments, bars, values, log=family == "lognormal")
            ax.set_xlabel(f"adjusted {name} / reference")
            handles, labels = ax.get_legend_handles_labels()
            figure.legend(handles, labels, loc="outside lower center", ncols=4)

        found.append(
            Drawing(
                f"intervals_{parameter}",
                f"Intervals of {_NAMES[parameter]}",
                f"For {len(environments)} environments, intervals of the adjusted {_NAMES[parameter]} divided by "
                "the reference, of every kind and method. The numbers are in the table of intervals.",
                (85.0, 22.0 + 17.0 * len(environments)),
                draw,
            )
        )
    return found


def _boundaries(document: Document) -> list[Drawing]:
    found = []
    for index, environment in enumerate(distinct(document["boundaries"], "environment"), start=1):
        rows = matching(document["boundaries"], environment=environment)
        any_row = rows[0]
        omega, reference = array(any_row["omega"]), array(any_row["reference"])
        coupled = array(any_row["coupled"]) if any_row.get("coupled") is not None else None
        paper = _paper_limits(rows)
        title = f"Boundary of |Z_h|, {environment}"
        found.append(
            Drawing(
                f"boundary_{index}_range",
                f"{title}, whole range",
                f"abs(Z_h) over the angular frequency, {environment}: reference, boundary of the average user"
                + (", and with the coupling." if coupled is not None else "."),
                (85.0, 66.0),
                partial(_draw_range, omega, paper, reference, coupled, f"{environment}: whole range"),
            )
        )
        low, high = document["zoom"][environment]
        window = (max(low, float(omega[0])), min(high, float(omega[-1])))
        if window[0] < window[1]:
            close = np.linspace(*window, 121)
            zoomed = [
                Limits(
                    one.label,
                    one.method,
                    refined(omega, one.lower, window),
                    refined(omega, one.upper, window),
                )
                for one in paper
                if np.all(np.isfinite(one.upper)) and np.all(one.lower > 0)
            ]
            found.append(
                Drawing(
                    f"boundary_{index}_zoom",
                    f"{title}, {window[0]:g} to {window[1]:g} rad/s",
                    f"The same curves close by, {window[0]:g} to {window[1]:g} rad/s.",
                    (85.0, 66.0),
                    partial(
                        _draw_zoom,
                        close,
                        zoomed,
                        refined(omega, reference, window),
                        refined(omega, coupled, window) if coupled is not None else None,
                        f"{environment}: {window[0]:g}–{window[1]:g} rad/s",
                    ),
                )
            )
        by_kind = {kind: _like_limits(rows, kind, family_of(document)) for kind in KINDS}
        by_kind = {kind: limits for kind, limits in by_kind.items() if limits}
        found.append(
            Drawing(
                f"boundary_{index}_ratio",
                f"{title}, limits divided by the reference",
                f"Boundaries of each kind divided by the reference's abs(Z_h), {environment}, over the whole range.",
                (175.0, 58.0),
                partial(_draw_ratios, omega, by_kind, reference, coupled, environment),
            )
        )
    return found


def _paper_limits(rows: list[Any]) -> list[Limits]:
    """Return the paper's corner curves, and the Bayesian curves of the same kind."""
    limits = []
    for method, families, shapes in (
        ("bayesian", ("lognormal", "normal"), ("pointwise", "envelope", "corner")),
        ("classical", ("normal", "lognormal"), ("corner", "envelope")),
    ):
        row = first(
            matching(rows, method=method, joint="marginal"),
            kind=("mean", "user", "share"),
            family=families,
            shape=shapes,
        )
        if row is not None:
            limits.append(_limits(row))
    return limits


def _like_limits(rows: list[Any], kind: str, family: str) -> list[Limits]:
    """Return the boundaries of both methods in one family and one shape."""
    candidates = matching(rows, kind=kind, joint="marginal")
    families = (family, "normal" if family == "lognormal" else "lognormal")
    for shape in ("envelope", "pointwise", "corner"):
        found = [first(matching(candidates, method=m, shape=shape), family=families) for m in METHODS]
        if any(found):
            return [_limits(row) for row in reversed(found) if row is not None]
    return []


def _limits(row: Mapping[str, Any]) -> Limits:
    label = f"{row['method']}, {row['kind']}, {row['shape']} ({row['family']})"
    return Limits(label, row["method"], array(row["lower"]), array(row["upper"]))


def _draw_range(
    omega: FloatArray,
    limits: list[Limits],
    reference: FloatArray,
    coupled: FloatArray | None,
    title: str,
    figure: Figure,
) -> None:
    ax = figure.add_subplot()
    draw_magnitude(ax, omega, limits, reference, coupled)
    ax.set_title(plain_text(title), loc="left")
    figure.legend(*ax.get_legend_handles_labels(), loc="outside lower center", ncols=2)


def _draw_zoom(
    omega: FloatArray,
    limits: list[Limits],
    reference: FloatArray,
    coupled: FloatArray | None,
    title: str,
    figure: Figure,
) -> None:
    ax = figure.add_subplot()
    draw_magnitude(ax, omega, limits, reference, coupled, log=False)
    ax.set_title(plain_text(title), loc="left")
    figure.legend(*ax.get_legend_handles_labels(), loc="outside lower center", ncols=2)


def _draw_ratios(
    omega: FloatArray,
    by_kind: Mapping[str, list[Limits]],
    reference: FloatArray,
    coupled: FloatArray | None,
    environment: str,
    figure: Figure,
) -> None:
    axes = figure.subplots(1, len(by_kind), sharex=True, sharey=False, squeeze=False)[0]
    for ax, (kind, limits) in zip(axes, by_kind.items(), strict=True):
        draw_ratio(ax, omega, limits, reference, coupled)
        ax.set_title(f"{kind}: {_KIND_NAMES[kind]}", loc="left")
    axes[0].set_ylabel("|Z$_h$| / reference")
    figure.supxlabel("angular frequency ω (rad/s)", fontsize=7.5)
    figure.suptitle(plain_text(environment), x=0.01, ha="left", fontsize=8)


def _band(document: Document) -> list[Drawing]:
    band = document["band"]
    if not band or not band.get("rows"):
        return []
    kinds = distinct(band["rows"], "kind")
    kind = kinds[0]
    seen = array([row["impedance"] for row in band["rows"]])
    grid = np.geomspace(seen.min() / 1.5, seen.max() * 1.5, 80)
    series = []
    for method in METHODS:
        rows = matching(band["rows"], method=method, kind=kind)
        if not rows:
            continue
        laws = {
            _LAW_NAMES.get(law["model"], law["model"]): _law(law, grid)
            for law in matching(band.get("laws", ()), method=method, kind=kind)
        }
        series.append(
            Widths(
                method,
                tuple(row["environment"] for row in rows),
                array([row["impedance"] for row in rows]),
                array([row["band"] for row in rows]),
                laws,
            )
        )

    def draw(figure: Figure) -> None:
        ax = figure.add_subplot()
        draw_band(ax, grid, series)
        figure.legend(*ax.get_legend_handles_labels(), loc="outside lower center", ncols=2)

    return [
        Drawing(
            "band",
            "Band against impedance",
            f"Width of the band of kind {kind} against the environment's impedance at {band['omega']:g} rad/s, "
            "with the fitted laws. The numbers are in the table beside it.",
            (120.0, 88.0),
            draw,
        )
    ]


def _law(law: Mapping[str, Any], impedance: FloatArray) -> FloatArray:
    values = {name: float(part["value"]) for name, part in law["parameters"].items()}
    return values.get("c", 0.0) + values.get("w", 1.0) * impedance ** values.get("p", 1.0)


def _stability(document: Document) -> list[Drawing]:
    coupling = document["coupling"]
    if not coupling or not coupling.get("omega") or not coupling.get("bound"):
        return []
    omega, bound = array(coupling["omega"]), array(coupling["bound"])
    curves = {name: array(curve) for name, curve in coupling["admittances"].items()}

    def draw(figure: Figure) -> None:
        draw_stability(figure.add_subplot(), omega, bound, curves)

    return [
        Drawing(
            "stability",
            "Stability of the coupling",
            "Re 1/Z_c of the coupling and the lower bound it has to stay above, over the angular frequency.",
            (120.0, 80.0),
            draw,
        )
    ]
