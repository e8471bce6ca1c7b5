"""Contrasts of conditions within subjects: of bias and of spread, per reference and overall."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
import pandas as pd

from percept.errors import RefusalError, counted
from percept.inference.classical.contrasts import paired_contrast, spread_ratio
from percept.inference.classical.trials import subject_means
from percept.inference.record import percent
from percept.scene import InferenceTable, Scene
from percept.sessions import Sessions
from percept.sessions.quantities import Quantity
from percept.sessions.records import Factor
from percept.study.basics import Array, Skipped, claim_of
from percept.study.intervals import Row

#: A row's `environment` is None for subjects' averages over the references that `references` lists.
CONTRAST = [
    "factor", "first", "second", "environment", "references", "parameter", "of", "kind", "method", "family",
    "level", "share", "confidence", "lower", "upper", "estimate", "p_value", "n", "covers",
]  # fmt: skip
_WHO = {"mean": "The average user's", "user": "The next user's"}


def classical_contrasts(
    sessions: Sessions, parameters: tuple[str, ...], scene: Scene
) -> Iterator[Row | Skipped]:
    """Yield the contrasts of every pair of levels: paired t intervals, and ratios of SDs."""
    assert sessions.factor is not None
    for parameter in parameters:
        quantity = sessions.quantities[parameter]
        values = _responses(sessions, quantity, scene)
        if isinstance(values, str):
            yield Skipped(f"contrasts of {quantity.label}", values)
            continue
        for pair in sessions.factor.pairs:
            yield from _of_pair(values, quantity, sessions.factor, pair, scene.inference)


def _responses(sessions: Sessions, quantity: Quantity, scene: Scene) -> pd.DataFrame | str:
    """Subjects' means on the model's scale, a column per cell; or why there are none."""
    p, lognormal = quantity.name, scene.inference.family == "lognormal"
    known = sessions.table[sessions.table[f"{p}_adj"].notna()]
    adjusted, reference = (known[f"{p}_{name}"].to_numpy(dtype=float) for name in ("adj", "ref"))
    if lognormal and (adjusted <= 0.0).any():
        return 'a value is zero or negative; family = "normal" takes it'
    if lognormal:
        response = np.log(adjusted / np.where(reference > 0.0, reference, 1.0))
    else:
        unit = reference if (reference > 0.0).all() else scene.model.scale.get(p)
        if unit is None:
            return f"a reference is missing or not positive; [model] scale.{p} gives a unit"
        response = (adjusted - np.nan_to_num(reference)) / unit
    assert sessions.factor is not None
    means = {}
    for cell in sessions.factor.cells:
        own = (known["environment"] == cell).to_numpy()
        who = known["subject"].to_numpy()[own]
        values = subject_means(response[own], who).values if own.any() else np.empty(0)
        means[cell] = pd.Series(values, index=list(dict.fromkeys(who)), dtype=float)
    return pd.DataFrame(means)


def _of_pair(
    values: pd.DataFrame, quantity: Quantity, factor: Factor, pair: tuple[str, str], asked: InferenceTable
) -> Iterator[Row | Skipped]:
    """Yield the contrasts of two levels, of each reference and of subjects' averages."""
    first, second = (
        values.reindex(columns=[factor.cell(e, level) for e in factor.environments]).set_axis(
            factor.environments, axis=1
        )
        for level in pair
    )
    both = first.notna() & second.notna()
    what = f"{quantity.label}, {pair[1]} against {pair[0]}"
    paired, several = both.any(axis=1), len(factor.environments) > 1
    if alone := int((~paired).sum()):
        yield Skipped(f"{counted(alone, 'subject')} in contrasts of {what}", "no reference has both levels")
    shared = [str(e) for e in both.columns[both[paired].all(axis=0)]] if paired.any() else []
    labels: Row = {"factor": factor.name, "first": pair[0], "second": pair[1], "parameter": quantity.name}
    for environment in factor.environments:
        kept = both[environment]
        cell = labels | {"environment": environment, "references": [environment]}
        ends = [frame.loc[kept, environment].to_numpy(dtype=float) for frame in (first, second)]
        yield from _rows(ends, cell, f"{what}, in {environment}", quantity, asked)
    if several and not shared:
        yield Skipped(f"overall contrast of {what}", "no reference has both levels for every subject")
    elif several:
        if left := [e for e in factor.environments if e not in shared]:
            yield Skipped(
                f"{', '.join(left)} in the overall contrast of {what}", "some subjects lack a level there"
            )
        cell = labels | {"environment": None, "references": shared}
        ends = [frame.loc[paired, shared].mean(axis=1).to_numpy(dtype=float) for frame in (first, second)]
        yield from _rows(ends, cell, f"{what}, overall", quantity, asked)


def _rows(
    ends: Sequence[Array], cell: Row, what: str, quantity: Quantity, asked: InferenceTable
) -> Iterator[Row | Skipped]:
    """Yield the rows of one reference, or of subjects' averages, by subjects' values at both levels."""
    first, second = ends
    if len(first) < 2:
        yield Skipped(f"contrast of {what}", "fewer than two subjects have both levels")
        return
    try:
        for kind in asked.kinds:
            found, p_value = paired_contrast(second - first, kind, **claim_of(asked))
            limits = [float(end) for end in (found.lower, found.upper, found.estimate)]
            yield contrast_row(
                cell, asked, quantity, limits, len(first),
                of="bias", kind=kind, method="classical", p_value=p_value if kind == "mean" else None,
            )  # fmt: skip
        ratio = spread_ratio(first, second, level=asked.level)
    except RefusalError as refused:
        yield Skipped(f"contrast of {what}", str(refused))
        return
    yield contrast_row(
        cell, asked, quantity, [ratio.lower, ratio.upper, ratio.estimate], ratio.n,
        of="spread", kind=None, method="classical", p_value=ratio.p_value,
    )  # fmt: skip


def contrast_row(
    cell: Row,
    asked: InferenceTable,
    quantity: Quantity,
    ends: list[float],
    n: int,
    *,
    of: str,
    kind: str | None,
    method: str,
    p_value: float | None = None,
) -> Row:
    """Make a row of contrasts on the response scale: ratios under the lognormal family."""
    if of == "bias" and asked.family == "lognormal":
        with np.errstate(over="ignore"):
            ends = np.exp(ends).tolist()
    row = {
        **cell,
        "of": of,
        "kind": kind,
        "method": method,
        "family": asked.family,
        "level": asked.level,
        "share": asked.held_share if kind == "share" else None,
        "confidence": asked.confidence if kind == "share" else None,
        **dict(zip(("lower", "upper", "estimate"), ends, strict=True)),
        "p_value": p_value,
        "n": n,
        "covers": _covers(cell, of, kind, method, asked, quantity, n),
    }
    return {name: row[name] for name in CONTRAST}


def _covers(
    cell: Row,
    of: str,
    kind: str | None,
    method: str,
    asked: InferenceTable,
    quantity: Quantity,
    n: int,
) -> str:
    """Say in a sentence what a contrast's limits hold."""
    how = f"{cell['second']} over {cell['first']}"
    if asked.family == "normal" and of == "bias":
        how = f"{cell['second']} less {cell['first']}, in references"
    sure = percent(asked.confidence if kind == "share" else asked.level)
    sure += " confidence" if method == "classical" else " probability under the model and its priors"
    what = f"{'ratio' if asked.family == 'lognormal' else 'difference'} of {quantity.label}"
    if of == "spread":
        start = f"The ratio of SDs between users of {quantity.label} ({how}) lies"
    elif kind == "share":
        start = f"For at least {percent(asked.held_share)} of all users the {what} ({how}) lies"
    else:
        typical = kind == "mean" and asked.family == "lognormal"
        start = f"{'The typical user’s' if typical else _WHO[str(kind)]} {what} ({how}) lies"
    return f"{start} between the limits, with {sure} (from {counted(n, 'user')} with both levels)."
