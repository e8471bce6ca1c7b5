"""Draw a whole study from the hierarchical model, with the true values it came from."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
import pandas as pd

from percept.errors import RefusalError, UsageError
from percept.inference.hierarchy.priors import Priors
from percept.simulate.design import Design
from percept.simulate.model import (
    Hyperparameters,
    Responses,
    Seed,
    TrueValues,
    draw_environments,
    draw_hyperparameters,
    draw_responses,
    generator,
)
from percept.simulate.tables import session_table


@dataclass(frozen=True, eq=False)
class SimulatedStudy:
    """A simulated study and what is true of it.

    Parameters
    ----------
    table : pandas.DataFrame
        Tidy sessions, one row per trial, as `session_table` describes.
    truth : TrueValues
        The parameters of the model, on its unit-free scale.
    responses : Responses
        The same trials on that scale, with the subject effects behind them.
    """

    table: pd.DataFrame
    truth: TrueValues
    responses: Responses


def simulate(
    design: Design,
    *,
    seed: Seed,
    values: Hyperparameters | TrueValues | None = None,
    priors: Priors | None = None,
    family: Literal["lognormal", "normal"] = "lognormal",
) -> SimulatedStudy:
    """Draw a study from the hierarchical model.

    Parameters
    ----------
    design : Design
        Subjects, environments and trials per cell.
    seed : int, SeedSequence or Generator
        Where the randomness comes from.
    values : Hyperparameters or TrueValues, optional
        What to hold fixed: hyperparameters (the environments are then drawn), or everything but the
        subjects and trials. Left out, all of it is drawn from `priors`.
    priors : Priors, optional
        Priors to draw from; the defaults when left out. Not allowed beside `values`.
    family : {"lognormal", "normal"}, optional
        The adjusted value is reference·exp(y) or reference·(1 + y).

    Returns
    -------
    SimulatedStudy
        The sessions and their truth.

    Raises
    ------
    UsageError
        An unknown family, `priors` beside `values`, values whose shape is not the design's.
    RefusalError
        A drawn response whose adjusted value no double can hold; `draw_responses` still gives it on
        the model's scale.
    """
    if family not in ("lognormal", "normal"):
        raise UsageError("the family must be 'lognormal' or 'normal'.", key="family", value=family)
    if values is not None and priors is not None:
        raise UsageError("priors have no use when the values are given.", key="priors")
    rng = generator(seed)
    truth = _true_values(values, design, priors or Priors(), rng)
    responses = draw_responses(truth, design, rng)
    reference = design.references[responses.environment]
    with np.errstate(over="ignore", under="ignore"):
        adjusted = reference * (np.exp(responses.y) if family == "lognormal" else 1 + responses.y)
    lost = ~np.isfinite(adjusted) if family == "normal" else ~(np.isfinite(adjusted) & (adjusted > 0))
    if lost.any():
        raise RefusalError(
            "a drawn response leaves the range of doubles.",
            value=float(responses.y[lost][0]),
            hint="Use narrower priors or another seed, or draw_responses for the model's scale.",
        )
    table = session_table(design, responses.subject, responses.environment, responses.trial, adjusted)
    return SimulatedStudy(table=table, truth=truth, responses=responses)


def _true_values(
    values: Hyperparameters | TrueValues | None, design: Design, priors: Priors, rng: np.random.Generator
) -> TrueValues:
    hyper = values.hyper if isinstance(values, TrueValues) else values
    if hyper is None:
        hyper = draw_hyperparameters(design, priors, rng)
    if np.shape(hyper.alpha) != (len(design.parameters),):
        raise UsageError(
            f"the values must be given for {len(design.parameters)} parameter(s).",
            key="alpha",
            value=np.shape(hyper.alpha),
        )
    if not isinstance(values, TrueValues):
        return draw_environments(hyper, design, rng)
    for name in ("beta", "sigma", "sigma_e"):
        shape = np.shape(getattr(values, name))
        if shape != design.references.shape:
            raise UsageError(f"{name} must have the shape {design.references.shape}.", key=name, value=shape)
    return values
