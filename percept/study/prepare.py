"""From sessions and a scene to the model that is sampled: one for every kind of study."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy import special

from percept.errors import RefusalError
from percept.inference.classical.moments import Moments
from percept.inference.model.model import LinearModel, Model, Product, Unpooled, plain_model
from percept.inference.model.statistics import from_summary
from percept.inference.record import Kind
from percept.results import Skipped
from percept.study.basics import Array
from percept.study.comparisons import Contrast
from percept.study.data import Data
from percept.study.linear import linear_model, options_of, priors_of, why_one_trial_sd
from percept.study.responses import NO_SCALE, ResponseScale, Trials, decades, refuse_no_ratio

#: A Bayesian interval may be so many times as wide as the classical one: beyond it the data tell
#: next to nothing. The page tells from one and a half on.
_MOST_WIDENED = 10.0
#: Grid of log sigma: e-folds beyond the data and the prior at each end, and points.
_GRID_MARGIN = 5.0
_GRID_POINTS = 4000


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Prepared:
    """A model of a study, not yet sampled."""

    data: Data
    model: Model  # The posterior
    scale: ResponseScale  # The way from responses to the units of the quantities
    counts: NDArray[np.int64]  # (C,) Subjects behind each cell
    repeats: bool | None  # Whether any cell holds more than one trial; None where it is not known
    trials: Trials | None = None  # None for published limits and without pooling
    skipped: tuple[Skipped, ...] = ()  # Trials and environments that are not in the model
    contrasts: tuple[Contrast, ...] | None = ()  # Of factors and covariates; None without pooling

    @property
    def sums(self) -> list[tuple[list[Contrast], tuple[Kind, ...]]]:
        """Contrasts of locations and the kinds of their limits: users' own, then other ones."""
        sums = [one for one in self.contrasts or () if not one.is_ratio]
        of_users = [one for one in sums if one.is_of_users]
        of_groups = [one for one in sums if not one.is_of_users]
        kinds = self.data.asked.kinds
        return [found for found in ((of_users, kinds), (of_groups, ("mean",))) if found[0]]


def prepare(data: Data) -> Prepared:
    """Build the model that the data and the scene ask for."""
    if data.scene.model.pooling == "none":
        return _unpooled(data)
    if data.sessions.form == "summary":
        # Limits hold no correlation.
        return _side_by_side([_of_limits(data, parameter) for parameter in data.parameters])
    names = data.parameters
    # One or two quantities share a model; of more, the two that are named.
    together = names if len(names) < 3 else data.asked.together or ()
    pair = tuple(name for name in names if name in together)
    groups = dict.fromkeys(pair if name in pair and len(pair) == 2 else (name,) for name in names)
    skipped = []
    if len(groups) > 1:
        why = "two are modelled together at most; [inference] together names them"
        skipped.append(Skipped("correlations of more than two parameters", why))
    return _side_by_side([_of_trials(data, group) for group in groups], skipped)


def prepared_beside(data: Data) -> Prepared | Skipped:
    """Build the model; skip a refused one where classical intervals of some cell stand without."""
    try:
        return prepare(data)
    except RefusalError as refused:
        known = any(cell.moments for of_family in data.cells.values() for cell in of_family)
        if data.asked.method != "both" or not known:
            raise
        return Skipped("Bayesian intervals", str(refused))


def _of_trials(data: Data, parameters: tuple[str, ...]) -> Prepared:
    """Model the trials of quantities that share a model."""
    for name in parameters:
        if name not in data.scene.model.scale:
            references = {cell: value for cell, value in data.reference.items() if cell[0] == name}
            refuse_no_ratio(references, data.quantities, hint=NO_SCALE.format(name))
    trials = data.trials(*parameters, partial=data.asked.method == "both")
    why_one_sd = why_one_trial_sd(trials, data.scene)
    model, compared = linear_model(trials, data, own_trial_sds=not why_one_sd)
    _refuse_ruling_prior(model, data)
    skipped = [skip for skip in compared if isinstance(skip, Skipped)]
    if why_one_sd and trials.statistics.repeats:
        what = " and ".join(data.quantities[name].label for name in parameters)
        skipped.insert(0, Skipped(f"subjects' own trial SDs of {what}", why_one_sd))
    return Prepared(
        data=data,
        model=model,
        scale=trials.scale,
        counts=np.isfinite(trials.statistics.cell_means).sum(axis=0).ravel(),
        repeats=trials.statistics.repeats,
        trials=trials,
        skipped=(*trials.skipped, *skipped),
        contrasts=tuple(contrast for contrast in compared if isinstance(contrast, Contrast)),
    )


def _refuse_ruling_prior(model: LinearModel, data: Data) -> None:
    """Refuse one cell whose interval is far wider by the prior of the spread than by the data.

    Both intervals are those of the mean. In the model it has normal laws over the posterior of log
    sigma: its prior times sigma^-df exp(-df sd²/(2 sigma²)).
    """
    if len(model.design.cells.names) > 1:
        return
    statistics = model.statistics
    priors = model.priors
    tail = 0.5 * (1.0 - data.asked.level)
    for p, parameter in enumerate(statistics.parameters):
        sd = statistics.sd[p, 0]
        df = statistics.df[p, 0]
        if sd == 0.0:
            continue
        highest = max(np.log(sd), priors.log_s_mean) + _GRID_MARGIN
        log_sigma = np.linspace(np.log(sd) - _GRID_MARGIN, highest, _GRID_POINTS)
        z = (log_sigma - priors.log_s_mean) / priors.log_s_sd
        of_data = log_sigma + 0.5 * np.exp(2.0 * (np.log(sd) - log_sigma))
        log_density = -0.5 * z * z - df * of_data
        density = np.exp(log_density - log_density.max())
        lowest = _MOST_WIDENED * sd * special.stdtrit(df, tail)
        below = special.ndtr(lowest / np.exp(log_sigma))
        if density @ below > tail * density.sum():
            label = data.quantities[parameter].label
            raise RefusalError(
                f"the prior of the spread makes the interval of {label} in"
                f" {statistics.environments[0]} more than {_MOST_WIDENED:g} times as wide as the"
                " data do.",
                hint=(
                    "Use the classical interval, lower log_s_mean in [model.priors], or set"
                    ' pooling = "none".'
                ),
            )


def _side_by_side(parts: list[Prepared], skipped: Sequence[Skipped] = ()) -> Prepared:
    """Put models of different parameters together, the cells of each in a row."""
    if len(parts) == 1:
        return parts[0]
    model = Product([part.model for part in parts])
    contrasts = []
    before = 0
    after = model.cell_rows.shape[1]
    for part in parts:
        locations = part.model.cell_rows.shape[1]
        after -= locations
        for contrast in part.contrasts or ():
            row = np.pad(contrast.row, (before, after))
            contrasts.append(dataclasses.replace(contrast, row=row))
        before += locations
    of_parts = dict.fromkeys(one for part in parts for one in part.skipped)
    return Prepared(
        data=parts[0].data,
        model=model,
        scale=ResponseScale(
            log=parts[0].scale.log,
            origin=np.concatenate([part.scale.origin for part in parts]),
            unit=np.concatenate([part.scale.unit for part in parts]),
        ),
        counts=np.concatenate([part.counts for part in parts]),
        repeats=any(part.repeats for part in parts) if parts[0].trials else None,
        skipped=(*skipped, *of_parts),
        contrasts=tuple(contrasts),
    )


def _of_limits(data: Data, parameter: str) -> Prepared:
    """Model a parameter of published limits."""
    moments = {cell: found for cell, found in _all_moments(data).items() if cell[0] == parameter}
    references = {cell: data.reference[cell] for cell in moments}
    refuse_no_ratio(references, data.quantities)
    reference = np.array(list(references.values()))
    scale = ResponseScale.of(reference, data.asked.family)
    mean, sd, counts = _arrays(moments)
    statistics = from_summary(
        (mean - scale.centre) / scale.unit,
        sd / scale.unit,
        counts,
        decades(reference[None])[0],
        parameter=parameter,
        environments=data.environments,
    )
    model = plain_model(statistics, priors_of(data.scene, (parameter,)), options_of(data.scene))
    _refuse_ruling_prior(model, data)
    return Prepared(data=data, model=model, scale=scale, counts=counts, repeats=None)


def _unpooled(data: Data) -> Prepared:
    """Each cell by itself, standardised by its own exact mean and SD."""
    moments = _all_moments(data)
    mean, sd, counts = _arrays(moments)
    log = data.asked.family == "lognormal"
    return Prepared(
        data=data,
        model=Unpooled(tuple(moments), counts),
        scale=ResponseScale(log, np.exp(mean) if log else mean, sd),
        counts=counts,
        repeats=any(cell.repeats for cell in moments.values()),
        contrasts=None if data.scene.terms else (),
    )


def _arrays(moments: dict[tuple[str, str], Moments]) -> tuple[Array, Array, NDArray[np.int64]]:
    """Means, SDs and numbers of subjects of C cells, (C,) each."""
    mean, sd, n = np.array([(cell.mean, cell.sd, cell.n) for cell in moments.values()]).T
    return mean, sd, n.astype(np.int64)


def _all_moments(data: Data) -> dict[tuple[str, str], Moments]:
    """Moments of every cell on the family's scale; refuse a cell that has none."""
    for cell in data.cells[data.asked.family]:
        if cell.moments is None:
            message = f"there is no posterior of {cell.where}: {cell.why}."
            hint = 'Set family = "normal", or leave the parameter or environment out in the scene.'
            raise RefusalError(message, hint=hint)
    return data.moments(data.asked.family)
