"""Boundaries of abs(Z_h): the two methods against each other, their shapes, and bands."""

from __future__ import annotations

import dataclasses
import json
import math
from collections.abc import Sequence

from percept.boundary.band import size_name
from percept.errors import capitalised
from percept.report.numbers import percentage, short
from percept.report.sections import (
    Cell,
    Columns,
    Section,
    Table,
    Value,
    of,
    plus_minus,
    table_of,
    value,
)
from percept.report.select import (
    METHOD_NAMES,
    METHODS,
    choice_said,
    chosen,
    distinct,
    each_by_itself,
    family_of,
    first,
    listed,
    matching,
    ordered,
    words_of,
)
from percept.results import (
    Band,
    BandLaw,
    BandPair,
    BandRow,
    BandStatement,
    Boundary,
    MethodPair,
    Results,
    plain,
)
from percept.results.fields import Array

__all__ = ["bands_sentences", "boundaries", "comparison"]

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
    words = words_of(results)
    pairs = results.band_pairs or ()
    sentences = [_differences(results.comparison or (), results)]
    sentences.append(" ".join(bands_sentences(pairs)))
    table = _pairs(results, matching(pairs, kind="user"))
    title = "Classical against Bayesian boundaries" if pairs else "Classical against Bayesian"
    figures = ["ratios"] if results.boundaries else []
    why = Section("why", "Why they differ", form="list", is_folded=True)
    if results.ladder:
        columns = {
            capitalised(words.environment): of("environment"),
            "Quantity": of("parameter"),
            "Kind": of("kind"),
            "Step": lambda row: _STEPS[row.cause].format(**vars(words)),
            "log width ratio": plus_minus("log_width", "log_width_error", style="plain"),
            "shift of the centre": plus_minus("centre", "centre_error", style="plain"),
        }
        caption = (
            "The effect of each step from the classical interval of the normal family to the"
            " Bayesian one: log ratio of widths, and shift in classical half-widths."
        )
        steps = table_of(caption, results.ladder.effects, columns)
        why = dataclasses.replace(why, sentences=list(results.ladder.notes), tables=[steps])
    return Section("comparison", title, sentences, [table], figures, parts=[why])


def _pairs(results: Results, pairs: Sequence[BandPair]) -> Table:
    """Return the methods' boundaries in pairs."""
    words = words_of(results)

    columns = {
        capitalised(words.environment): of("environment"),
        "middle, largest shift": of("place.largest", 3, "percent"),
        "at ω (rad/s)": of("place.omega", 3),
        "middle, median shift": of("place.median", 3, "percent"),
        "log width ratio, largest": of("width.largest", 3),
        "at ω, rad/s": of("width.omega", 3),
        "log width ratio, median": of("width.median", 3),
    }
    caption = (
        f"The next {words.user}’s Bayesian boundary against the classical one (exact envelopes)."
        " Shift: middle over middle, less one. Width ratios are natural logarithms: at 0.69 it is"
        " twice as wide."
    )
    return table_of(caption, pairs, columns, name="band_pairs", csv="band_pairs")


def _differences(pairs: Sequence[MethodPair], results: Results) -> str:
    """Say how far the methods' intervals lie apart."""
    ratios = [pair.width_ratio for pair in pairs if pair.width_ratio is not None]
    farthest: dict[str | None, float] = {}  # By quantity; None for all whose shift is a fraction
    for pair in pairs:
        if pair.shift is not None:
            name = None if pair.relative else pair.parameter
            farthest[name] = max(farthest.get(name, 0.0), abs(pair.shift))
    if not ratios or not farthest:
        return ""
    shifts = []
    for name, size in farthest.items():
        if name is None:
            shifts.append(percentage(size, 2))
        else:
            unit = results.data.quantities[name].unit
            shifts.append(f"{short(size, 2)} {unit}".strip())
    least = short(min(ratios), 2)
    most = short(max(ratios), 2)
    widths = f"{least} times" if least == most else f"{least} to {most} times"
    return (
        f"Of the same family and kind, Bayesian intervals are {widths} as wide as classical ones. "
        f"Their estimates lie at most {listed(shifts)} apart."
    )


def bands_sentences(pairs: Sequence[BandPair]) -> list[str]:
    """Say where the methods' boundaries lie farthest apart in place, and in width."""
    if not pairs:
        return []
    place = max(pairs, key=lambda pair: abs(pair.place.largest))
    width = max(pairs, key=lambda pair: abs(pair.width.largest))
    sign = "higher" if place.place.largest > 0 else "lower"
    apart = percentage(abs(place.place.largest), 2)
    ratio = short(math.exp(width.width.largest), 2)
    return [
        f"The Bayesian band of |Z_h| lies farthest from the classical one in {_where(place)}:"
        f" {apart} {sign} at {short(place.place.omega, 2)} rad/s.",
        f"Its width differs most in {_where(width)}: {ratio} times at"
        f" {short(width.width.omega, 2)} rad/s.",
    ]


def _where(pair: BandPair) -> str:
    return f"{pair.environment} (kind {pair.kind})"


def boundaries(results: Results) -> Section:
    """Return what boundaries are, close views, every curve to explore, and bands."""
    words = words_of(results)
    records = results.boundaries
    shapes = [f"{name}: {_SHAPES[name]}." for name in ordered(_SHAPES, records, "shape")]
    shares = [
        record.device_share
        for record in matching(records, shape="pointwise")
        if record.device_share is not None
    ]
    sentences = []
    if records:
        sentences.append(
            "A realistic performance boundary holds the |Z_h| at the handle that"
            f" {words.users} take for the reference, over ω. The term and the equations are of"
            " “The effect of static virtual couplings on realistic performance of haptic"
            " systems”."
        )
    if shares:
        sentences.append(
            "Pointwise and simultaneous Bayesian curves average over the device’s posterior, which"
            f" makes {percentage(min(shares), 2)} to {percentage(max(shares), 2)} of their squared"
            " width. All other curves have the device at its point."
        )
    return Section(
        "boundaries",
        "Boundaries and bands",
        sentences,
        figures=["boundaries_close"] if results.close else [],
        parts=[
            Section("explore", "Explore every boundary", parts=_explorer(results), is_folded=True),
            Section("shapes", "The shapes of boundaries", shapes, form="list", is_folded=True),
            *_bands(results),
        ],
        is_folded=True,
    )


def _explorer(results: Results) -> list[Section]:
    """Return the curves for the page's script, and which environments it leaves out."""
    names = distinct(results.boundaries, "environment")
    main = [record for record in results.boundaries if each_by_itself(record)]
    curves = []
    for name in chosen(names):
        of_environment = matching(main, environment=name)
        if of_environment:
            curves.append(_curves(of_environment, results.zoom.get(name)))
    if not curves:
        return []
    text = json.dumps(plain(curves), ensure_ascii=False, separators=(",", ":"))
    # A script element ends at the first end tag in it, wherever that stands.
    data = text.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026")
    left_out = choice_said(names, words_of(results).environments)
    return [Section("said", "", [left_out]), Section("explorer-data", "", [data], form="curves")]


def _curves(records: Sequence[Boundary], zoom: tuple[float, float] | None) -> dict[str, object]:
    """Return what the page's script draws of one environment; each grid stands once."""
    grids: list[list[float | None]] = []
    limits = []
    for record in records:
        grid = _short(record.omega)
        if grid not in grids:
            grids.append(grid)
        limits.append(
            {
                "kind": record.kind,
                "method": record.method,
                "family": record.family,
                "shape": record.shape,
                "grid": grids.index(grid),
                "lower": _short(record.lower),
                "upper": _short(record.upper),
            }
        )
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
    names = distinct(results.band.rows, "parameter")
    parts = [_band(results, results.band, name) for name in names]
    last = parts[-1]
    return [*parts[:-1], dataclasses.replace(last, tables=[*last.tables, _trend(results.band)])]


def _trend(band: Band) -> Table:
    """Return the hierarchical model's own trend of spreads over references."""
    columns = {
        "Quantity": of("parameter"),
        "κ": of("value", 3),
        "lower": of("lower", 3),
        "upper": of("upper", 3),
        "probability of κ < 0": of("below_zero", 3, "percent"),
    }
    caption = (
        "Trend κ of the hierarchical model: change of the logarithm of the relative spread per"
        " decade of the reference. Weber’s law is κ = 0."
    )
    return table_of(caption, band.kappa or (), columns)


def _band(results: Results, band: Band, parameter: str | None) -> Section:
    """Return how wide the bands of one quantity are, and which law they follow."""
    words = words_of(results)
    own = {"family": family_of(results), "parameter": parameter}
    rows = matching(band.rows, **own)
    laws = matching(band.laws, **own)
    statements = matching(band.statements, **own)
    size = size_name(parameter)
    name = "band" if parameter is None else f"band_{parameter}"
    quantity = None if parameter is None else results.data.quantities[parameter]
    symbol = "|Z_e|" if quantity is None else "reference"
    unit = "N·s/m" if quantity is None else quantity.unit
    in_unit = f" ({unit})" if unit else ""
    lines = []
    methods = ordered(METHODS, rows, "method")
    for environment in distinct(rows, "environment"):
        of_environment = matching(rows, environment=environment)
        line = [(environment,), value(of_environment[0], size)]
        for method in methods:
            row = first(matching(of_environment, method=method))
            line += [of("band")(row), of("relative", 3, "percent")(row)]
        lines.append(line)
    heads = [capitalised(words.environment), f"{symbol}{in_unit}"]
    for method in methods:
        heads += [f"{METHOD_NAMES[method]}{in_unit}", f"relative, {METHOD_NAMES[method]}"]
    what = "|Z_e|" if quantity is None else quantity.words
    at = f" at {band.omega:g} rad/s, without the device" if parameter is None else ""
    caption = f"Width of the next {words.user}’s interval of {what}{at}."
    return Section(
        name,
        f"Band of {what}",
        [_answer(rows, statements, results, size), *_law_said(laws)],
        [
            Table(caption, heads, lines, name=name, csv=name),
            _law_table(laws, symbol, words.environment),
            _statement_table(statements),
        ],
        figures=[name],
    )


def _statement_table(statements: Sequence[BandStatement]) -> Table:
    """Return how probably statements on bands are true, by method."""
    methods = ordered(METHODS, statements, "method")
    lines = []
    for said in distinct(statements, "statement"):
        line: list[Cell] = [(said,)]
        for method in methods:
            row = first(matching(statements, statement=said, method=method))
            line.append(of("probability", 3, "percent")(row))
        lines.append(line)
    caption = "Share of posterior draws, or of bootstrap samples, in which a statement is true."
    return Table(caption, ["Statement", *(METHOD_NAMES[method] for method in methods)], lines)


def _law_table(laws: Sequence[BandLaw], symbol: str, environment: str) -> Table:
    """Return the laws with their parameters and errors."""

    def parameters(law: BandLaw) -> Cell:
        parts: list[str | Value] = []
        for name in law.parameters:
            low, middle, high = (
                value(law, "parameters", name, end, digits=3) for end in ("lower", "value", "upper")
            )
            parts += [f"{', ' if parts else ''}{name} = ", *middle, " (", *low, " to ", *high, ")"]
        return tuple(parts)

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


def _law_said(laws: Sequence[BandLaw]) -> list[str]:
    """Return what the law that is ahead says, by the better method."""
    best = max(laws, key=lambda law: (law.method == "bayesian", law.best), default=None)
    return [] if best is None else [best.sentence]


def _answer(
    rows: Sequence[BandRow], statements: Sequence[BandStatement], results: Results, size: str
) -> str:
    """Say whether the relative band is narrower where the size is lowest."""
    said = [row for row in statements if ", relative to" in row.statement]
    if not said:
        return ""
    row = said[-1]
    words = words_of(results)
    of_method = matching(rows, method=row.method)
    low = min(of_method, key=lambda one: getattr(one, size))
    high = max(of_method, key=lambda one: getattr(one, size))
    decision = results.provenance.scene["inference"]["decision"]
    at = "low impedance" if size == "impedance" else "low references"
    claim = f"the data do not tell whether discrimination is better at {at}"
    if row.probability >= decision:
        claim = f"discrimination is better at {at}"
    elif row.probability <= 1.0 - decision:
        claim = f"discrimination is not better at {at}"
    return (
        f"Relative to the size, {claim}: the band of {words.users} is"
        f" {percentage(low.relative, 2)} in {low.environment}, the lowest, and"
        f" {percentage(high.relative, 2)} in {high.environment}, the highest. The probability that"
        f" it is narrower in {low.environment} is {percentage(row.probability, 2)}"
        f" ({METHOD_NAMES[row.method]})."
    )
