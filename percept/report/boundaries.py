"""Boundaries of abs(Z_h): the two methods against each other, their shapes, and bands."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from percept.boundary.band import size_name
from percept.errors import capitalised
from percept.report.basics import (
    METHOD_NAMES,
    Cell,
    Columns,
    Section,
    Table,
    bracketed,
    column,
    distinct,
    family_of,
    is_known,
    listed,
    matching,
    of,
    percentage,
    plus_minus,
    present,
    short,
    side_by_side,
    table_of,
    unwidened,
    value,
)
from percept.report.biases import drawn_said
from percept.results import (
    Band,
    BandLaw,
    BandPair,
    Results,
    share_curves,
)

_SHAPES = {
    "corner": (
        "both lower limits of k and b together, and both upper limits together, as in the paper"
        " (Eqs 16 and 17); the two curves can cross"
    ),
    "envelope": "the exact smallest and largest |Z_h| of any k and b within their limits",
    "pointwise": "limits of |Z_h| by the law of k and b together; the level holds at each ω alone",
    "simultaneous": (
        "limits between which a whole curve stays: pointwise limits at a higher level (Bayesian),"
        " or the limits of Hotelling’s ellipse joined with the pointwise ones (classical)"
    ),
}
#: Fields of a boundary that the page's script draws.
_CURVES = (
    "environment",
    "kind",
    "method",
    "family",
    "shape",
    "omega",
    "lower",
    "upper",
    "reference",
    "coupled",
)
_LAWS = {"weber": "w·{0}", "offset": "c + w·{0}", "power": "w·{0}^p"}
#: Steps of the ladder, in words.
_STEPS = {
    "prior": "each {environment} modelled by itself, with the priors",
    "pooling": "all {environments} together",
    "scale": "the lognormal family",
    "sampling": "the same model",
    "all": "all steps",
}


def comparison(results: Results) -> Section:
    """Return how the methods differ: a figure and a table of the next user's boundaries."""
    pairs = matching(results.band_pairs or (), kind="user")
    return Section(
        "comparison",
        "Classical against Bayesian",
        [_differences(results)],
        [_pairs(results, pairs)],
        ["ratios"] if results.boundaries else [],
        parts=[_why(results)],
    )


def _why(results: Results) -> Section:
    """Return the steps of the ladder."""
    if results.ladder is None:
        return Section("why")
    words = results.data.words
    columns: Columns = {
        capitalised(words.environment): of("environment"),
        "Quantity": of("parameter"),
        "Kind": of("kind"),
        "Step": lambda row: _STEPS[row.cause].format(**vars(words)),
        "log width ratio": plus_minus("log_width", "log_width_error", style="plain"),
        "shift of the centre": plus_minus("centre", "centre_error", style="plain"),
    }
    caption = (
        "The effect of each step from the classical interval of the normal family to the Bayesian"
        " one: log ratio of widths, and shift in classical half-widths."
    )
    table = table_of(caption, results.ladder.effects, columns)
    notes = results.ladder.notes
    return Section("why", "Why they differ", notes, [table], form="list", is_folded=True)


def _pairs(results: Results, pairs: Sequence[BandPair]) -> Table:
    """Return the methods' boundaries in pairs."""
    words = results.data.words
    columns: Columns = {
        capitalised(words.environment): of("environment"),
        "shift, largest": of("place", style="bias"),
        "at ω (rad/s)": of("place_omega", 3),
        "shift, median": of("place_median", style="bias"),
        "width ratio, farthest": of("width", 3, "ratio"),
        "at ω, rad/s": of("width_omega", 3),
        "width ratio, median": of("width_median", 3, "ratio"),
    }
    whom = f"The next {words.user}’s"
    caption = f"{whom} Bayesian boundary against the classical one. Shift: of the middle."
    return table_of(caption, pairs, columns, name="band_pairs")


def _differences(results: Results) -> str:
    """Say how the widths of the methods' intervals compare."""
    pairs = results.comparison or ()
    ratios = [pair.width_ratio for pair in pairs if pair.width_ratio is not None]
    if not ratios:
        return ""
    ends = min(ratios), max(ratios)
    if not is_known(*ends):
        return "Some intervals span many decades: how their widths compare says nothing."
    widths = " to ".join(dict.fromkeys(short(ratio, 2) for ratio in ends))
    return (
        f"Of the same family and kind, Bayesian intervals are {widths} times as wide as classical"
        " ones."
    )


def boundaries(results: Results) -> Section:
    """Return what boundaries are, every curve to explore, and bands."""
    words = results.data.words
    records = results.boundaries
    sentences = []
    if records:
        sentences.append(
            "A realistic performance boundary holds, over ω, the |Z_h| at the handle that"
            f" {words.users} take for the reference."
        )
        sentences.append(drawn_said(results))
    pointwise = matching(records, shape="pointwise")
    shares = [record.device_share for record in pointwise if record.device_share is not None]
    if shares:
        sentences.append(
            "Pointwise and simultaneous Bayesian curves average over the device’s posterior, which"
            f" makes {percentage(min(shares), 2)} to {percentage(max(shares), 2)} of their squared"
            " width. All other curves have the device at its point."
        )
    shapes = [f"{name}: {_SHAPES[name]}." for name in present(_SHAPES, records, "shape")]
    return Section(
        "boundaries",
        "Boundaries and bands" if records else "Bands",
        sentences,
        parts=[
            Section(
                "shapes",
                "The shapes of boundaries" if shapes else "",
                shapes,
                form="list",
            ),
            _explorer(results),
            *_bands(results),
        ],
        is_folded=True,
    )


def _explorer(results: Results) -> Section:
    """Return the curves for the page's script, as report.json has them, with fewer digits."""
    curves = [
        {name: _short(getattr(record, name)) for name in _CURVES}
        for record in unwidened(results.boundaries)
    ]
    if not curves:
        return Section("explore")
    document = {"boundaries": curves, "impedances": share_curves(curves)}
    text = json.dumps(document, ensure_ascii=False, separators=(",", ":"))
    # A script element ends at the first end tag in it, wherever that stands.
    data = text.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026")
    return Section("explore", "Explore every boundary", [data], form="curves", is_folded=True)


def _short(value: Any) -> Any:
    """Round an array to seven digits; what is not finite is not drawn."""
    if not isinstance(value, np.ndarray):
        return value
    return [float(f"{one:.7g}") if math.isfinite(one) else None for one in value.tolist()]


def _bands(results: Results) -> list[Section]:
    """Return a part on the band of the impedance, or of each quantity."""
    band = results.band
    if band is None:
        return []
    return [_band(results, band, name) for name in distinct(band.rows, "parameter")]


def _band(results: Results, band: Band, parameter: str | None) -> Section:
    """Return how wide the bands of one quantity are, and which law they follow."""
    words = results.data.words
    chosen = {"family": family_of(results), "parameter": parameter}
    rows = matching(band.rows, **chosen)
    laws = matching(band.laws, **chosen)
    if parameter is None:
        name, what, symbol, unit = "band", "|Z_e|", "|Z_e|", "N·s/m"
        at = f" at {band.omega:g} rad/s, without the device"
    else:
        quantity = results.data.quantities[parameter]
        name, what, symbol, unit = f"band_{parameter}", quantity.words, "reference", quantity.unit
        at = ""
    size = of(size_name(parameter))
    columns: Columns = {
        capitalised(words.environment): str,
        symbol + bracketed(unit): column(rows, "environment", size),
    }
    columns |= side_by_side(rows, "environment", ("method",), of("band"))
    relative = side_by_side(rows, "environment", ("method",), of("relative", 3, "percent"))
    columns |= {f"relative, {head}": cell for head, cell in relative.items()}
    caption = f"Width of the next {words.user}’s interval of {what}{bracketed(unit)}{at}."
    best = max(laws, key=lambda law: (law.method == "bayesian", law.best), default=None)
    sentences = [best.sentence] if best else []
    unlimited = distinct([row for row in rows if math.isinf(row.band)], "environment")
    if unlimited:
        sentences.append(
            f"In {listed(unlimited)} there are too few {words.subjects} for a finite upper limit."
            " Without it no law is fitted."
        )
    return Section(
        name,
        f"Band of {what}",
        sentences,
        [
            table_of(caption, distinct(rows, "environment"), columns, name=name, csv="band"),
            _law_table(laws, symbol, words.environment),
            _trend(band, parameter),
        ],
        figures=[name],
    )


def _trend(band: Band, parameter: str | None) -> Table:
    """Return the hierarchical model's own trend of spreads over references."""
    columns: Columns = {
        "Quantity": of("parameter"),
        "κ": of("value", 3),
        "lower": of("lower", 3),
        "upper": of("upper", 3),
        "probability of κ < 0": of("below_zero", 3, "percent"),
    }
    caption = (
        "Trend κ of the model: change of the logarithm of the relative spread per decade of the"
        " reference. Weber’s law is κ = 0."
    )
    chosen = [row for row in band.kappa or () if parameter in (None, row.parameter)]
    return table_of(caption, chosen, columns)


def _law_table(laws: Sequence[BandLaw], symbol: str, environment: str) -> Table:
    """Return the laws with their parameters and errors."""

    def parameters(law: BandLaw) -> Cell:
        parts: Cell = ()
        for name, one in law.parameters.items():
            ends = (*value(one.lower, 3), " to ", *value(one.upper, 3))
            comma = ", " if parts else ""
            parts = (*parts, f"{comma}{name} = ", *value(one.value, 3), " (", *ends, ")")
        return parts

    columns: Columns = {
        "Law": lambda law: _LAWS[law.model].format(symbol),
        "Method": lambda law: METHOD_NAMES[law.method],
        "estimate (limits)": parameters,
        "error": of("left_out_error", 3),
        "ahead": of("best", 3, "percent"),
    }
    caption = (
        f"Three laws of the band. Error: typical error of the logarithm for the {environment} left"
        " out. Ahead: how often the law has the smallest."
    )
    return table_of(caption, laws, columns)
