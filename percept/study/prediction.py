"""Intervals and boundaries of an environment nobody tested."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from percept import haptics
from percept.errors import RefusalError, UsageError
from percept.html import NotebookRecord
from percept.inference.model.gaussian import Joint
from percept.inference.model.limits import Limits
from percept.inference.model.predictions import new_environment, new_name
from percept.inference.sampling.endpoints import batch_errors
from percept.results import Boundary, IntervalRow, Skipped
from percept.sessions.quantities import IMPEDANCE, Quantities
from percept.study.basics import Array, Stream, claim_of, generator
from percept.study.boundaries import BoundaryDrawing
from percept.study.intervals import bayesian_rows
from percept.study.regions import Law, posterior_laws, rectangles
from percept.study.responses import ResponseScale, refuse_no_ratio

if TYPE_CHECKING:
    from percept.study.fit import Fit
    from percept.study.study import Study


# Spreads of the new environment per posterior draw: its spread is drawn from the trend.
_REPEATS = 4
_NO_LOGARITHM = "and environments are compared by the logarithm of their reference"


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class Prediction(NotebookRecord):
    """What the hierarchical model expects of an untested environment."""

    environment: str  #: Its name; with factors, the rows name its conditions too
    #: Decades by which each reference lies above the tested range; negative below.
    beyond: dict[str, float]
    #: As `percept.Study.intervals`, and `monte_carlo`, the error of the limits over the half-width.
    intervals: pd.DataFrame
    boundaries: tuple[Boundary, ...]  #: Of abs(Z_h); empty without a device
    skipped: tuple[Skipped, ...] = ()  #: What it lacks, such as curves, and why
    quantities: Quantities = dataclasses.field(default_factory=lambda: IMPEDANCE, repr=False)

    @property
    def extrapolates(self) -> bool:
        """Whether a reference lies outside the tested range."""
        return any(self.beyond.values())

    @property
    def sentence(self) -> str:
        """How far the environment lies from what was tested."""
        outside = []
        for name, decades in self.beyond.items():
            if decades:
                side = "above" if decades > 0 else "below"
                label = self.quantities[name].label
                outside.append(f"{label} lies {abs(decades):.2g} decades {side} the tested range")
        if outside:
            return f"Extrapolation: {' and '.join(outside)}."
        return "Inside the tested range of each parameter."


def predict(
    study: Study,
    *,
    stiffness: float | None = None,
    damping: float | None = None,
    at: Mapping[str, float] | None = None,
) -> Prediction:
    """Predict intervals and boundaries of an untested environment.

    Parameters
    ----------
    study : Study
        With a passed Bayesian fit that pools environments.
    stiffness, damping : float
        Of the environment, N/m and N·s/m; each where the study analyses it.
    at : mapping of str to float, optional
        References by the name of their quantity, in its unit; "m" is the environment's mass, kg,
        where the tested ones differ in theirs.

    Returns
    -------
    Prediction

    Raises
    ------
    UsageError
        A reference that is missing, not positive, or of a parameter that the study does not
        analyse.
    RefusalError
        No passed Bayesian fit, a tested reference of zero, or one environment.
    """
    data = study.data
    values, mass = _references(study, {"k": stiffness, "b": damping, **(at or {})})
    refuse_no_ratio(data.reference, data.quantities, why=_NO_LOGARITHM)
    fit = study.fit
    if fit is None:
        raise RefusalError(
            "the classical method has no model of environments nobody tested.",
            hint='Set method = "both" or "bayesian".',
        )
    if not fit.passed:
        raise RefusalError(f"the posterior is withheld: {fit.withheld}")
    tested = np.log10([[data.reference[p, e] for e in fit.environments] for p in data.parameters])
    log = np.log10(values)
    beyond = log - np.clip(log, tested.min(axis=1), tested.max(axis=1))
    decades = log - tested.mean(axis=1)
    rng = generator(data.asked.seed, Stream.NEW_ENVIRONMENT)
    by_condition = new_environment(fit.model, fit.points, decades, repeats=_REPEATS, rng=rng)
    expected = {new_name(condition): users for condition, users in by_condition.items()}
    scale = ResponseScale.of(values, data.asked.family)
    # A draw's repeats belong together.
    batch = np.repeat(fit.run.batches(), _REPEATS)
    rows: list[IntervalRow] = []
    errors: list[float] = []
    laws: list[Law] = []
    for name, users in expected.items():
        for row, error in _rows(fit, users, name, scale, batch):
            rows.append(row)
            errors.append(error)
        if data.is_impedance and data.sessions.form == "trials":
            laws += posterior_laws(name, users, batch, rows[-1].n, scale, data.asked)
    boundaries: list[Boundary] = []
    skipped: list[Skipped] = []
    if study.setup is not None:
        k, b = values.tolist()
        environment = haptics.Environment(stiffness=k, damping=b, mass=mass)
        setup = dataclasses.replace(study.setup, references=dict.fromkeys(expected, environment))
        regions = [*rectangles(rows), *(law.region for law in laws if law.region)]
        tolerance = data.asked.tolerance
        drawing = BoundaryDrawing(setup, regions, laws, study.scene.frequency, tolerance)
        for one in drawing.drawn(expected):
            if isinstance(one, Skipped):
                skipped.append(one)
            else:
                boundaries.append(one)
    return Prediction(
        environment=new_name(""),
        beyond=dict(zip(data.parameters, beyond.tolist(), strict=True)),
        intervals=pd.DataFrame(rows).assign(monte_carlo=errors),
        boundaries=tuple(boundaries),
        skipped=tuple(skipped),
        quantities=data.quantities,
    )


def _references(study: Study, asked: Mapping[str, float | None]) -> tuple[Array, float]:
    """Return the references (P,) and the mass, kg, of the new environment.

    UsageError of those missing, not positive, or not analysed. The mass is that of all tested
    environments, if they have one.
    """
    parameters = study.data.parameters
    quantities = study.data.quantities
    given = {name: value for name, value in asked.items() if value is not None}
    mass = 0.0
    if study.data.is_impedance and "m" not in quantities:
        tested = set(study.sessions.masses.values())
        if "m" not in given and len(tested) > 1:
            masses = ", ".join(f"{mass:g}" for mass in sorted(tested))
            message = f"the mass of the new environment is missing; tested ones have {masses} kg."
            raise UsageError(message, key="m", hint='Give it: at={"m": …}, or --at m=….')
        mass = float(given.pop("m", min(tested)))
    for name, value in given.items():
        if name not in parameters:
            known = {**IMPEDANCE, **quantities}.get(name)
            message = f"the study does not analyse {known.label if known else name}."
            raise UsageError(message, key=name, value=value, hint="Leave it out.")
    for name in parameters:
        if not 0.0 < given.get(name, math.nan) < math.inf:
            positive = f"a positive number of {quantities[name].unit}".removesuffix(" of ")
            message = f"the {quantities[name].label} of the new environment must be {positive}."
            raise UsageError(message, key=name, value=given.get(name), hint="Give it.")
    return np.array([float(given[name]) for name in parameters]), mass


def _rows(
    fit: Fit, users: Joint, name: str, scale: ResponseScale, batch: NDArray[np.intp]
) -> Iterator[tuple[IntervalRow, float]]:
    """Yield the row of every kind and parameter, and its limits' error in half-widths."""
    limits = Limits(fit.model, **claim_of(fit.data.asked))
    moments = users.moments()
    cells = [(parameter, name) for parameter in fit.parameters]
    counts = [int(fit.counts.max())] * len(cells)
    for kind in fit.data.asked.kinds:
        lower, upper, influence = limits.of(kind, moments)
        worst = batch_errors(influence, batch).reshape(2, -1).max(axis=0) / (0.5 * (upper - lower))
        with np.errstate(over="ignore", under="ignore"):
            ends = scale.native(np.stack([lower, upper, moments.mean.mean(axis=0)]))
        rows = bayesian_rows(fit, kind, cells, ends, scale.origin.tolist(), counts)
        yield from zip(rows, worst.tolist(), strict=True)
