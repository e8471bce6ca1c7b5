"""Classical against Bayesian intervals and curves of equal family and kind, with the reasons in numbers."""

from __future__ import annotations

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from percept.boundary.curves import curve_gap
from percept.boundary.records import Boundary
from percept.inference.hierarchy.density import ConditionalMoments
from percept.scene import Scene
from percept.sessions import Sessions
from percept.study.bayesian import Fit
from percept.study.classical import cell_moments
from percept.study.prior_pull import PriorPull, prior_pull

Array = NDArray[np.float64]
_KEYS = ["environment", "parameter", "kind", "family"]


def compare_intervals(
    intervals: pd.DataFrame, fit: Fit, scene: Scene, sample_sd: dict[tuple[str, str], float]
) -> pd.DataFrame:
    """Pair the methods' marginal intervals and say why they differ."""
    marginal = intervals[intervals["joint"] == "marginal"]
    pair = [
        marginal[marginal["method"] == method][[*_KEYS, "lower", "upper", "estimate"]]
        for method in ("classical", "bayesian")
    ]
    both = pair[0].merge(pair[1], on=_KEYS, suffixes=("_classical", "_bayesian"))
    if both.empty:
        return both
    log = scene.inference.family == "lognormal"
    classical, bayesian = (both[f"upper_{m}"] - both[f"lower_{m}"] for m in ("classical", "bayesian"))
    both["width_ratio"] = bayesian / classical
    both["shift"] = both["estimate_bayesian"] / both["estimate_classical"] - 1.0
    ends = {
        name: _scaled(both[name].to_numpy(), log) for name in both if str(name).startswith(("lower", "upper"))
    }
    low = np.maximum(ends["lower_classical"], ends["lower_bayesian"])
    high = np.minimum(ends["upper_classical"], ends["upper_bayesian"])
    span = np.maximum(ends["upper_classical"], ends["upper_bayesian"]) - np.minimum(
        ends["lower_classical"], ends["lower_bayesian"]
    )
    both["overlap"] = np.maximum(high - low, 0.0) / span
    widths = {m: ends[f"upper_{m}"] - ends[f"lower_{m}"] for m in ("classical", "bayesian")}
    centres = {m: 0.5 * (ends[f"upper_{m}"] + ends[f"lower_{m}"]) for m in ("classical", "bayesian")}
    cells = list(zip(both["parameter"], both["environment"], strict=True))
    sd = np.array([sample_sd[cell] for cell in cells])
    both["spread_ratio"] = _posterior_sd(fit, cells) / sd
    both["certainty_ratio"] = widths["bayesian"] / widths["classical"] / both["spread_ratio"]
    both["shift_sds"] = (centres["bayesian"] - centres["classical"]) / sd
    _add_prior(both, fit, scene, widths["bayesian"], cells)
    _add_scale(both, marginal, classical)
    for method, width in widths.items():
        both[f"to_mean_{method}"] = _over_mean(both, width)
    return both


def compare_curves(boundaries: tuple[Boundary, ...]) -> pd.DataFrame:
    """Compare the methods' boundaries of equal environment, kind, family, joint treatment and shape."""
    labels = ("environment", "kind", "family", "joint", "shape")
    known = {(b.method, *(getattr(b, name) for name in labels)): b for b in boundaries}
    rows = []
    for (method, *key), boundary in known.items():
        other = known.get(("bayesian", *key))
        if method == "classical" and other is not None:
            row: dict[str, object] = dict(zip(labels, key, strict=True))
            for side, gap in curve_gap(boundary, other).items():
                row |= {f"area_{side}": gap.area, f"largest_{side}": gap.largest, f"omega_{side}": gap.omega}
            rows.append(row)
    return pd.DataFrame(rows)


def sample_sds(sessions: Sessions, parameters: tuple[str, ...], family: str) -> dict[tuple[str, str], float]:
    """Take the SD of the subjects' values of every cell that has one."""
    found = {}
    for cell in cell_moments(sessions, parameters, family):
        if cell.moments is not None:
            found[cell.parameter, cell.environment] = float(cell.moments.on_scale(family).sd)
    return found


def _scaled(values: Array, log: bool) -> Array:
    return np.log(values) if log else values


def _posterior_sd(fit: Fit, cells: list[tuple[str, str]]) -> Array:
    """Typical SD between users per cell, on the family's scale (N/m and N·s/m under normal)."""
    laws = ConditionalMoments.unpack(fit.run.components.reshape(-1, fit.run.components.shape[-1]))
    typical = np.exp(np.log(laws.population_sd).mean(axis=0))
    scale = fit.prepared.scale
    column = {cell: c for c, cell in enumerate(fit.prepared.model.cells)}
    return np.array([typical[column[cell]] * scale.unit[column[cell]] for cell in cells])


def _add_prior(
    both: pd.DataFrame,
    fit: Fit,
    scene: Scene,
    width: Array,
    cells: list[tuple[str, str]],
) -> None:
    found: PriorPull | None = prior_pull(fit, scene)
    if found is None:
        return
    column = {cell: c for c, cell in enumerate(fit.prepared.model.cells)}
    log, scale = scene.inference.family == "lognormal", fit.prepared.scale
    for s, side in enumerate(("lower", "upper")):
        own, wider = (
            {kind: _scaled(scale.native(ends[s]), log) for kind, ends in limits.items()}
            for limits in (found.own, found.limits)
        )
        pulls = [
            own[kind][column[cell]] - wider[kind][column[cell]]
            for kind, cell in zip(both["kind"], cells, strict=True)
        ]
        both[f"prior_{side}"] = np.array(pulls) / (0.5 * width)
    both["prior_effective"] = found.effective


def _add_scale(both: pd.DataFrame, marginal: pd.DataFrame, width: pd.Series[float]) -> None:
    keys = ["environment", "parameter", "kind"]
    family = both["family"].iloc[0]
    other = marginal[(marginal["method"] == "classical") & (marginal["family"] != family)]
    known = {tuple(row[name] for name in keys): row["upper"] - row["lower"] for _, row in other.iterrows()}
    wanted = both[keys].itertuples(index=False, name=None)
    both["scale_ratio"] = [known.get(key, np.nan) for key in wanted] / width.to_numpy()


def _over_mean(both: pd.DataFrame, width: Array) -> list[float]:
    keys = list(zip(both["environment"], both["parameter"], both["kind"], strict=True))
    known = dict(zip(keys, width.tolist(), strict=True))
    return [known[key] / known.get((key[0], key[1], "mean"), np.nan) for key in keys]
