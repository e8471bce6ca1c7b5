"""Boundaries of abs(Z_h): the two methods against each other, their shapes, and bands."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence

from percept.boundary.band import size_name
from percept.errors import capitalised
from percept.report.biases import drawn_said, foremost
from percept.report.numbers import is_known, percentage, short
from percept.report.sections import (
    Cell,
    Columns,
    Section,
    Table,
    column,
    of,
    plus_minus,
    side_by_side,
    table_of,
    value,
)
from percept.report.select import (
    METHOD_NAMES,
    distinct,
    family_of,
    listed,
    matching,
    present,
    unwidened,
)
from percept.results import Array, BandLaw, BandPair, Boundary, Coefficient, Results, plain

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
_LAWS = {"weber": "w·{0}", "offset": "c + w·{0}", "power": "w·{0}^p"}
#: Steps of the ladder, in words.
_STEPS = {
    "prior": "each {environment} modelled by itself, with the priors",
    "trials": "single trials instead of means over trials",
    "pooling": "all {environments} together",
    "own_trials": "a trial SD for each {subject}",
    "correlation": "both quantities together",
    "scale": "the lognormal family",
    "sampling": "the same model",
    "all": "all steps",
}


def comparison(results: Results) -> Section:
    """Return how the methods differ: a figure and a table of the next user's boundaries."""
    pairs = results.band_pairs or ()
    sentences = [_differences(results), " ".join(bands_sentences(pairs))]
    title = "Classical against Bayesian boundaries" if pairs else "Classical against Bayesian"
    return Section(
        "comparison",
        title,
        sentences,
        [_pairs(results, matching(pairs, kind="user"))],
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
        "shift, largest": of("place.largest", 3, "percent"),
        "at ω (rad/s)": of("place.omega", 3),
        "shift, median": of("place.median", 3, "percent"),
        "width ratio, largest": of("width.largest", 3),
        "at ω, rad/s": of("width.omega", 3),
        "width ratio, median": of("width.median", 3),
    }
    caption = (
        f"The next {words.user}’s Bayesian boundary against the classical one (exact envelopes)."
        " Shift: of the middle. Width ratios: logarithms (0.69 is twice as wide)."
    )
    return table_of(caption, pairs, columns, name="band_pairs", csv="band_pairs")


def _differences(results: Results) -> str:
    """Say how far the methods' intervals lie apart."""
    pairs = results.comparison or ()
    ratios = [pair.width_ratio for pair in pairs if pair.width_ratio is not None]
    farthest: dict[str, float] = {}  # By unit; shifts of relative quantities are fractions
    for pair in pairs:
        if pair.shift is not None:
            unit = "%" if pair.relative else results.data.quantities[pair.parameter].unit
            size = abs(pair.shift) * (100.0 if pair.relative else 1.0)
            farthest[unit] = max(farthest.get(unit, 0.0), size)
    if not ratios or not farthest:
        return ""
    shifts = listed([f"{short(size, 2)} {unit}".rstrip() for unit, size in farthest.items()])
    ends = min(ratios), max(ratios)
    widths = " to ".join(dict.fromkeys(short(ratio, 2) for ratio in ends))
    said = (
        f"Of the same family and kind, Bayesian intervals are {widths} times as wide as classical"
        " ones."
    )
    if not is_known(*ends):
        said = "Some intervals span many decades: how their widths compare says nothing."
    return f"{said} The methods’ estimates lie at most {shifts} apart."


def bands_sentences(pairs: Sequence[BandPair]) -> list[str]:
    """Say where the methods' boundaries lie farthest apart in place, and in width."""
    if not pairs:
        return []
    place = max(pairs, key=lambda pair: abs(pair.place.largest))
    width = max(pairs, key=lambda pair: abs(pair.width.largest))
    sign = "higher" if place.place.largest > 0 else "lower"
    apart = percentage(abs(place.place.largest), 2)
    ratio = math.exp(width.width.largest)
    times = f"is {short(ratio, 2)} times as wide"
    if not is_known(min(ratio, 1.0), max(ratio, 1.0)):
        times = "or the classical one spans many decades"
    return [
        "The Bayesian band of |Z_h| lies farthest from the classical one in"
        f" {place.environment} (kind {place.kind}): {apart} {sign} at"
        f" {short(place.place.omega, 2)} rad/s.",
        f"Its width differs most in {width.environment} (kind {width.kind}): it"
        f" {times} at {short(width.width.omega, 2)} rad/s.",
    ]


def boundaries(results: Results) -> Section:
    """Return what boundaries are, close views, every curve to explore, and bands."""
    words = results.data.words
    records = results.boundaries
    sentences = []
    if records:
        sentences.append(
            "A realistic performance boundary holds the |Z_h| at the handle that"
            f" {words.users} take for the reference, over ω. The term and the equations are of"
            " “The effect of static virtual couplings on realistic performance of haptic"
            " systems”."
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
        "Boundaries and bands",
        sentences,
        parts=[
            Section(
                "shapes",
                "The shapes of boundaries" if shapes else "",
                shapes,
                figures=["boundaries_close"] if results.close else [],
                form="list",
            ),
            _explorer(results),
            *_bands(results),
        ],
        is_folded=True,
    )


def _explorer(results: Results) -> Section:
    """Return the curves for the page's script."""
    curves = []
    shown = foremost(results)
    for name in distinct(results.boundaries, "environment"):
        records = matching(unwidened(results.boundaries), environment=name)
        if records and name in shown:
            curves.append(_curves(records, results.zoom.get(name)))
    if not curves:
        return Section("explore")
    text = json.dumps(plain(curves), ensure_ascii=False, separators=(",", ":"))
    # A script element ends at the first end tag in it, wherever that stands.
    data = text.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026")
    return Section("explore", "Explore every boundary", [data], form="curves", is_folded=True)


def _curves(records: Sequence[Boundary], zoom: tuple[float, float] | None) -> dict[str, object]:
    """Return what the page's script draws of one environment; each grid stands once."""
    grids: list[list[float | None]] = []
    limits = []
    for record in records:
        grid = _short(record.omega)
        if grid not in grids:
            grids.append(grid)
        drawn: dict[str, object] = {"grid": grids.index(grid)}
        for name in ("kind", "method", "family", "shape"):
            drawn[name] = getattr(record, name)
        limits.append(drawn | {"lower": _short(record.lower), "upper": _short(record.upper)})
    coupled = records[0].coupled
    return {
        "name": records[0].environment,
        "zoom": zoom,
        "grids": grids,
        "reference": _short(records[0].reference),
        "coupled": None if coupled is None else _short(coupled),
        "limits": limits,
    }


def _short(values: Array) -> list[float | None]:
    """Round to seven digits; what is not finite is not drawn."""
    return [float(f"{value:.7g}") if math.isfinite(value) else None for value in values.tolist()]


def _bands(results: Results) -> list[Section]:
    """Return a part on the band of the impedance, or of each quantity."""
    if results.band is None or not results.band.rows:
        return []
    return [_band(results, name) for name in distinct(results.band.rows, "parameter")]


def _band(results: Results, parameter: str | None) -> Section:
    """Return how wide the bands of one quantity are, and which law they follow."""
    assert results.band is not None
    words = results.data.words
    own = {"family": family_of(results), "parameter": parameter}
    rows = matching(results.band.rows, **own)
    laws = matching(results.band.laws, **own)
    statements = matching(results.band.statements, **own)
    size = size_name(parameter)
    what = "|Z_e|"
    symbol = "|Z_e|"
    unit = "N·s/m"
    if parameter is not None:
        what = results.data.quantities[parameter].words
        symbol = "reference"
        unit = results.data.quantities[parameter].unit
    in_unit = f" ({unit})" if unit else ""
    columns: Columns = {
        capitalised(words.environment): str,
        f"{symbol}{in_unit}": column(rows, "environment", of(size)),
    }
    for field, cell in (("", of("band")), ("relative, ", of("relative", 3, "percent"))):
        for head, shown in side_by_side(rows, "environment", ("method",), cell).items():
            columns[field + head] = shown
    at = "" if parameter else f" at {results.band.omega:g} rad/s, without the device"
    caption = f"Width of the next {words.user}’s interval of {what}{in_unit}{at}."
    name = "band" if parameter is None else f"band_{parameter}"
    likely = {"Statement": str} | side_by_side(
        statements, "statement", ("method",), of("probability", 3, "percent")
    )
    likely_caption = "Share of posterior draws, or of bootstrap samples, in which it is true."
    best = max(laws, key=lambda law: (law.method == "bayesian", law.best), default=None)
    sentences = [_is_narrower(results, parameter), best.sentence if best else ""]
    return Section(
        name,
        f"Band of {what}",
        [" ".join(sentence for sentence in sentences if sentence)],
        [
            table_of(caption, distinct(rows, "environment"), columns, name=name, csv="band"),
            _law_table(laws, symbol, words.environment),
            table_of(likely_caption, distinct(statements, "statement"), likely),
            _trend(results, parameter),
        ],
        figures=[name],
    )


def _trend(results: Results, parameter: str | None) -> Table:
    """Return the hierarchical model's own trend of spreads over references."""
    rows = results.band.kappa if results.band and results.band.kappa else ()
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
    own = [row for row in rows if parameter in (None, row.parameter)]
    return table_of(caption, own, columns)


def _law_table(laws: Sequence[BandLaw], symbol: str, environment: str) -> Table:
    """Return the laws with their parameters and errors."""

    def parameters(law: BandLaw) -> Cell:
        parts: Cell = ()
        for name, coefficient in law.parameters.items():
            comma = ", " if parts else ""
            parts = (*parts, f"{comma}{name} = ", *_coefficient(coefficient))
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


def _coefficient(one: Coefficient) -> Cell:
    return (*value(one.value, 3), " (", *value(one.lower, 3), " to ", *value(one.upper, 3), ")")


def _is_narrower(results: Results, parameter: str | None) -> str:
    """Say whether the relative band is narrower where the size is lowest."""
    band = results.band
    own = {"family": family_of(results), "parameter": parameter}
    statements = matching(band.statements if band else (), **own)
    relative = [row for row in statements if ", relative to" in row.statement]
    if band is None or not relative:
        return ""
    row = relative[-1]
    size = size_name(parameter)
    rows = sorted(matching(band.rows, **own, method=row.method), key=lambda one: getattr(one, size))
    low = rows[0]
    high = rows[-1]
    decision = results.provenance.scene["inference"]["decision"]
    claim = "the data do not tell whether discrimination is better"
    if row.probability >= decision:
        claim = "discrimination is better"
    elif row.probability <= 1.0 - decision:
        claim = "discrimination is not better"
    return (
        f"Relative to the size, {claim} at low {'references' if parameter else 'impedance'}: the"
        f" band of {results.data.words.users} is {percentage(low.relative, 2)} in"
        f" {low.environment}, the lowest, and {percentage(high.relative, 2)} in"
        f" {high.environment}, the highest. The probability that it is narrower in"
        f" {low.environment} is {percentage(row.probability, 2)} ({METHOD_NAMES[row.method]})."
    )
