"""The linear design of a study: which columns join its cells, and which of them vary.

A cell is an environment at one level of every factor. The location of cell c in quantity p, and the
setting of subject i there, are

    beta_cp  = sum over fixed terms X_cp theta_p + sum over own terms Q_c zeta_jp
    user_icp = beta_cp + sum over subject terms Z_cp v_ip + w_icp

The coefficients theta have known prior SDs. Each environment j has deviations zeta of its own,
whose SD tau is estimated for each term. Each subject has effects v, whose covariance over the
quantities is estimated for each term. Log SDs of a cell follow log-linear columns in the same way.
"""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray
from scipy import linalg

from percept.inference.hierarchy.priors import Priors

__all__ = ["Cells", "Design", "Factors", "Term", "contrast_columns", "design_of"]

Array = NDArray[np.float64]
Indices = NDArray[np.intp]

#: Names of terms that every design of several environments has.
LEVEL = "level"
TREND = "trend"


@dataclasses.dataclass(frozen=True)
class Cells:
    """Cells of a study: C of them in J environments, P quantities."""

    names: tuple[str, ...]
    environment: Indices  # (C,) Environment of each cell
    environments: tuple[str, ...]  # Names of the J environments
    x: Array  # (P, C) log10 of each reference over the geometric mean of the references


@dataclasses.dataclass(frozen=True)
class Factors:
    """Levels of the cells under every factor, and the terms that the model has."""

    levels: Mapping[str, tuple[str, ...]]  # Levels of each factor
    level: Mapping[str, Indices]  # (C,) Level of each cell under each factor
    terms: tuple[tuple[str, ...], ...]  # Each a factor, or several that interact
    between: frozenset[str] = frozenset()  # Factors of which a subject has one level only
    spread: tuple[str, ...] = ()  # Factors whose levels differ in the spread of subject effects
    slopes: bool = False  # Whether every subject has a trend over the references of its own


@dataclasses.dataclass(frozen=True, eq=False)
class Term:
    """Columns of a term over the cells, and its name."""

    name: str
    columns: Array  # (K, P, C)


@dataclasses.dataclass(frozen=True, eq=False)
class Design:
    """All terms of a study."""

    cells: Cells
    fixed: tuple[Term, ...]  # Columns times the prior SD of their coefficients
    own: tuple[Term, ...]  # Deviations that each environment has of its own
    subject: tuple[Term, ...]  # Effects that each subject has
    between: tuple[Term, ...]  # Of log sigma between subjects, times their prior SDs
    trial: tuple[Term, ...]  # Of log sigma between trials, times their prior SDs
    stretch: tuple[Term, ...]  # Of the log size of subject effects, times their prior SDs

    @property
    def parameters(self) -> int:
        """Number of quantities P."""
        return len(self.cells.x)


def contrast_columns(levels: int) -> Array:
    """Orthogonal columns (levels, levels - 1) that sum to zero over the levels.

    Their squares sum to 1/2, so that a coefficient of prior SD s gives every difference of two
    levels the prior SD s. With two levels the column is (-1/2, 1/2).
    """
    return np.asarray(-linalg.helmert(levels).T / np.sqrt(2.0))


def design_of(cells: Cells, factors: Factors, priors: Priors) -> Design:
    """Write out the columns of a study's terms.

    Parameters
    ----------
    cells : Cells
        The cells, with their environments and references.
    factors : Factors
        Levels of the cells, and terms.
    priors : Priors
        Prior SDs of all coefficients.

    Returns
    -------
    Design
    """
    ones = np.ones_like(cells.x)
    level = Term(LEVEL, ones[None])
    effects = [_effect(cells, factors, term) for term in factors.terms]
    several = len(cells.environments) > 1
    trend = [Term(TREND, cells.x[None])] if several else []
    main_effects = [
        effect for effect, term in zip(effects, factors.terms, strict=True) if len(term) == 1
    ]
    within = [
        effect
        for effect, term in zip(effects, factors.terms, strict=True)
        if not factors.between.intersection(term)
    ]
    slopes = trend if factors.slopes else []
    stretched = [effect for effect in main_effects if effect.name in factors.spread]
    fixed_sd = {LEVEL: priors.alpha_sd, TREND: priors.gamma_sd}
    between_sd = {LEVEL: priors.log_s_sd, TREND: priors.kappa_sd}
    trial_sd = {LEVEL: priors.log_s_e_sd, TREND: priors.kappa_e_sd}
    return Design(
        cells=cells,
        fixed=_scaled([level, *trend, *effects], fixed_sd, priors.lambda_sd),
        own=(level, *effects) if several else (),
        subject=(level, *slopes, *within),
        between=_scaled([level, *trend, *main_effects], between_sd, priors.psi_sd),
        trial=_scaled([level, *trend, *main_effects], trial_sd, priors.psi_sd),
        stretch=_scaled(stretched, {}, priors.psi_sd),
    )


def _scaled(terms: Sequence[Term], sd: Mapping[str, float], usual: float) -> tuple[Term, ...]:
    """Multiply the columns of terms by the prior SDs of their coefficients."""
    scaled = []
    for term in terms:
        columns = term.columns * sd.get(term.name, usual)
        scaled.append(dataclasses.replace(term, columns=columns))
    return tuple(scaled)


def _effect(cells: Cells, factors: Factors, term: tuple[str, ...]) -> Term:
    """Columns of a factor, or of an interaction: products of the columns of its factors."""
    per_factor = []
    for factor in term:
        columns = contrast_columns(len(factors.levels[factor]))
        per_factor.append(columns[factors.level[factor]].T)
    products = [np.prod(columns, axis=0) for columns in itertools.product(*per_factor)]
    shape = (len(products), *cells.x.shape)
    return Term(":".join(term), np.broadcast_to(np.stack(products)[:, None], shape))
