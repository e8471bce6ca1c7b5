"""Intervals and boundaries of an environment nobody tested."""

from __future__ import annotations

import dataclasses
import html
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from percept import haptics
from percept.boundary.records import Boundary
from percept.errors import RefusalError, UsageError
from percept.inference.hierarchy.models import IntervalEstimands
from percept.inference.hierarchy.new_environment import NewEnvironment, new_environment
from percept.inference.record import Interval
from percept.scene import Scene
from percept.sessions.values import UNITS
from percept.study.apparatus import Apparatus
from percept.study.bayesian import Fit
from percept.study.boundaries import Range, environment_boundaries
from percept.study.posterior import thinned_points
from percept.study.regions import Draws, Region, displayable, draw_ellipses, rectangles
from percept.study.responses import ResponseScale, refuse_no_ratio
from percept.study.streams import Stream, generator
from percept.study.units import NAMES

if TYPE_CHECKING:
    from percept.study.study import Study

Array = NDArray[np.float64]
_DRAWS = 16_384
_BATCHES = 20
#: Why a reference of zero cannot be predicted from, nor for.
NO_PLACE = "and has no place on the scale that environments are compared on"


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class Prediction:
    """What the hierarchical model expects of an untested environment."""

    environment: str  # Its name
    decades: dict[str, float]
    beyond: dict[str, float]
    nearest: str  # The tested environment whose references are nearest
    distance: float  # How far that is, decades
    intervals: pd.DataFrame
    boundaries: tuple[Boundary, ...]  # Of abs(Z_h)

    @property
    def extrapolates(self) -> bool:
        """Whether a reference lies outside the tested range."""
        return any(self.beyond.values())

    @property
    def sentence(self) -> str:
        """How far the environment lies from what was tested."""
        outside = [
            f"{NAMES[p]} lies {abs(d):.2g} decades {'above' if d > 0 else 'below'} the tested range"
            for p, d in self.beyond.items()
            if d
        ]
        nearest = f"the nearest tested environment is {self.nearest}, {self.distance:.2g} decades away"
        if outside:
            return f"Extrapolation: {' and '.join(outside)}; {nearest}."
        return f"Inside the tested range of each parameter; {nearest}."

    def _repr_html_(self) -> str:
        shown = self.intervals.drop(columns="covers").to_html(index=False, escape=True)
        return f"<p>{html.escape(self.sentence)}</p>{shown}"


def predict(
    study: Study,
    *,
    stiffness: float | None = None,
    damping: float | None = None,
    name: str = "new",
    kinds: tuple[str, ...] | None = None,
    curves: bool = True,
) -> Prediction:
    """Predict intervals and boundaries of an untested environment."""
    scene = study.scene
    given = {"k": stiffness, "b": damping}
    for parameter, value in given.items():
        if value is not None and parameter not in study.parameters:
            raise UsageError(
                f"the study does not analyse {NAMES[parameter]}.",
                key=parameter,
                value=value,
                hint="Leave it out.",
            )
    reference = np.array([_positive(p, given[p]) for p in study.parameters])
    refuse_no_ratio(study.reference, why=NO_PLACE)
    fit = _fit(study)
    # Those the fit is of: an environment where some parameter was never adjusted is not among them.
    environments = tuple(dict.fromkeys(e for _, e in fit.prepared.model.cells))
    tested = np.array([[study.reference[p, e] for e in environments] for p in study.parameters])
    logs = np.log10(tested)
    at = np.log10(reference)
    x = at - logs.mean(axis=1)
    beyond = np.maximum(at - logs.max(axis=1), 0.0) + np.minimum(at - logs.min(axis=1), 0.0)
    far = np.hypot.reduce(logs - at[:, None], axis=0)
    expected = expected_users(fit, x, scene)
    scale = ResponseScale.of(reference, scene.inference.family)
    intervals = _intervals(study, fit, expected, scale, kinds or scene.inference.kinds, name)
    return Prediction(
        environment=name,
        decades=dict(zip(study.parameters, x.tolist(), strict=True)),
        beyond=dict(zip(study.parameters, beyond.tolist(), strict=True)),
        nearest=environments[int(far.argmin())],
        distance=float(far.min()),
        intervals=intervals,
        boundaries=_boundaries(study, fit, expected, scale, intervals, reference, name) if curves else (),
    )


def expected_users(fit: Fit, x: Array, scene: Scene) -> NewEnvironment:
    """Work out what a fit expects of the users of a new environment."""
    points, _ = thinned_points(fit)
    rng = generator(scene.inference.seed, Stream.NEW_ENVIRONMENT)
    repeats = max(4, round(_DRAWS / len(points)))
    return new_environment(fit.prepared.model, points, x, repeats=repeats, rng=rng)


def _fit(study: Study) -> Fit:
    if study.fit is None:
        raise RefusalError(
            "the classical method has no model of environments nobody tested.",
            hint='Set method = "both" or "bayesian".',
        )
    if not study.fit.run.gate.passed:
        raise RefusalError("the posterior is withheld: " + " ".join(study.fit.run.gate.reasons))
    return study.fit


def _positive(parameter: str, value: float | None) -> float:
    if value is None:
        raise UsageError(
            f"the {NAMES[parameter]} of the new environment is missing.",
            key=parameter,
            hint=f"The study analyses it: give a positive number of {UNITS[parameter]}.",
        )
    if not (np.isfinite(value) and value > 0):
        raise UsageError(
            f"the {NAMES[parameter]} of the new environment must be a positive number of {UNITS[parameter]}.",
            key=parameter,
            value=value,
        )
    return float(value)


def _intervals(
    study: Study,
    fit: Fit,
    expected: NewEnvironment,
    scale: ResponseScale,
    kinds: tuple[str, ...],
    name: str,
) -> pd.DataFrame:
    asked = study.scene.inference
    estimands = IntervalEstimands(
        fit.prepared.model,
        kinds=kinds,
        level=asked.level,
        share=asked.held_share,
        confidence=asked.confidence,
    )
    laws = expected.laws
    estimate = _native(scale, laws.mean.mean(axis=0))
    rows: list[dict[str, Any]] = []
    for kind in kinds:
        lower, upper, influence = estimands.limits(kind, laws)
        error = _monte_carlo(influence).reshape(2, -1).max(axis=0) / (0.5 * (upper - lower))
        low, high = _native(scale, lower), _native(scale, upper)
        for p, parameter in enumerate(study.parameters):
            interval = Interval(
                kind=kind,  # type: ignore[arg-type]
                method="bayesian",
                family=asked.family,
                level=asked.level,
                lower=float(low[p]),
                upper=float(high[p]),
                estimate=float(estimate[p]),
                n=int(fit.prepared.counts.max()),
                share=asked.held_share if kind == "share" else None,
                confidence=asked.confidence if kind == "share" else None,
                repeats=fit.prepared.repeats,
                approximate=study.sessions.form == "summary" and asked.family == "lognormal",
                unit=UNITS[parameter],
            )
            rows.append(
                {
                    "environment": name,
                    "parameter": parameter,
                    "reference": float(scale.origin[p]),
                    **interval.as_dict(),
                    "monte_carlo": float(error[p]),
                }
            )
    return pd.DataFrame(rows)


def _monte_carlo(influence: Array) -> Array:
    """Estimate standard errors from means over batches of draws in the order they were kept."""
    size = len(influence) // _BATCHES
    means = influence[: size * _BATCHES].reshape(_BATCHES, size, -1).mean(axis=1)
    return means.std(axis=0, ddof=1) / np.sqrt(_BATCHES)


def _boundaries(
    study: Study,
    fit: Fit,
    expected: NewEnvironment,
    scale: ResponseScale,
    intervals: pd.DataFrame,
    reference: Array,
    name: str,
) -> tuple[Boundary, ...]:
    known = study.apparatus
    if known is None:
        return ()
    asked = study.scene.inference
    rng = generator(asked.seed, Stream.NEW_BOUNDARIES)
    drawn = dict(zip(("mean", "user"), expected.draw(rng), strict=True))
    draws = [
        Draws(
            kind=kind,
            method="bayesian",
            family=asked.family,
            level=asked.level,
            pairs={name: (native[:, 0], native[:, 1])},
        )
        for kind, responses in drawn.items()
        if kind in asked.kinds and study.sessions.form == "trials"
        for native in [displayable(_native(scale, responses))]
    ]
    regions: list[Region] = list(rectangles(intervals))
    for part in draws:
        regions += draw_ellipses(part, {name: int(fit.prepared.counts.max())})
    environment = haptics.Environment(stiffness=float(reference[0]), damping=float(reference[1]))
    apparatus = Apparatus(known.device, known.period, known.hold, {name: environment}, known.coupling)
    frequencies: Range = study.frequencies
    return tuple(environment_boundaries(apparatus, name, regions, draws, frequencies))


def _native(scale: ResponseScale, response: Array) -> Array:
    with np.errstate(over="ignore", under="ignore"):
        return scale.native(response)
