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

__all__ = [
    "LEVEL",
    "TREND",
    "Cells",
    "Design",
    "Factors",
    "Term",
    "cell_columns",
    "contrast_columns",
    "design_of",
    "new_cells",
    "trend_rows",
]

Array = NDArray[np.float64]
Indices = NDArray[np.intp]

#: Names of terms that every design of several environments has.
LEVEL = "level"
TREND = "trend"
#: Fields of a design that hold terms.
_TERMS = ("fixed", "own", "subject", "between", "trial", "stretch")


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

    def at(self, cells: Indices) -> Term:
        """Columns over some of the cells."""
        return Term(self.name, self.columns[:, :, cells])


@dataclasses.dataclass(frozen=True, eq=False)
class Design:
    """All terms of a study."""

    cells: Cells
    factors: Factors
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

    def identity(self) -> tuple[object, ...]:
        """Return what decides a density: cells and columns, which the factors say no more than."""
        parts = [dataclasses.astuple(self.cells)]
        for name in _TERMS:
            terms: tuple[Term, ...] = getattr(self, name)
            parts.append(tuple(dataclasses.astuple(term) for term in terms))
        return tuple(parts)

    def under(self, priors: Priors) -> Design:
        """Columns under other priors."""
        whole = design_of(self.cells, self.factors, priors)
        if any(term.name == TREND for term in self.between):
            return whole
        return whole.without_spread_trend()

    def at(self, cells: Indices) -> Design:
        """Columns of some of the cells."""
        kept = {}
        for name in _TERMS:
            terms: tuple[Term, ...] = getattr(self, name)
            kept[name] = tuple(term.at(cells) for term in terms)
        level = {name: values[cells] for name, values in self.factors.level.items()}
        own = Cells(
            names=tuple(self.cells.names[cell] for cell in cells),
            environment=self.cells.environment[cells],
            environments=self.cells.environments,
            x=self.cells.x[:, cells],
        )
        factors = dataclasses.replace(self.factors, level=level)
        return dataclasses.replace(self, cells=own, factors=factors, **kept)

    def without_spread_trend(self) -> Design:
        """Take the trend over references out of the SDs: they are a constant share of these."""
        between = tuple(term for term in self.between if term.name != TREND)
        trial = tuple(term for term in self.trial if term.name != TREND)
        return dataclasses.replace(self, between=between, trial=trial)


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
        factors=factors,
        fixed=_scaled([level, *trend, *effects], fixed_sd, priors.lambda_sd),
        own=(level, *effects) if several else (),
        subject=(level, *slopes, *within),
        between=_scaled([level, *trend, *main_effects], between_sd, priors.psi_sd),
        trial=_scaled([level, *trend, *main_effects], trial_sd, priors.psi_sd),
        stretch=_scaled(stretched, {}, priors.psi_sd),
    )


def new_cells(design: Design, x: Array, priors: Priors) -> Design:
    """Write out the columns of an untested environment, at the levels of all cells.

    Parameters
    ----------
    design : Design
        Of several environments.
    x : ndarray
        Decades of the references above the geometric mean of those tested, shape (P,).
    priors : Priors
        As the design has them.

    Returns
    -------
    Design
        Its cells are named by their levels alone.
    """
    cells = design.cells
    factors = design.factors
    grid = np.stack([*factors.level.values(), np.zeros_like(cells.environment)])
    # As the cells stand: in the order in which their levels first appear.
    _, first = np.unique(grid, axis=1, return_index=True)
    like = np.sort(first)
    names = []
    for cell in like:
        own = []
        for name, level in factors.level.items():
            labels = factors.levels[name]
            own.append(labels[level[cell]])
        names.append(", ".join(own))
    environments = (*cells.environments, "")
    added = np.full(len(like), len(cells.environments))
    new_x = np.repeat(x[:, None], len(like), axis=1)
    joined = Cells(
        names=(*cells.names, *names),
        environment=np.concatenate([cells.environment, added]),
        environments=environments,
        x=np.concatenate([cells.x, new_x], axis=1),
    )
    longer = {}
    for name, level in factors.level.items():
        longer[name] = np.concatenate([level, level[like]])
    more = dataclasses.replace(factors, level=longer)
    whole = dataclasses.replace(design, cells=joined, factors=more).under(priors)
    return whole.at(np.arange(len(cells.names), len(joined.names)))


def trend_rows(design: Design, priors: Priors) -> dict[str, Array]:
    """Weights (2 P, f) of the fixed coefficients in each condition's intercepts, then its slopes.

    Coefficients stand over their prior SDs.
    """
    identity = np.eye(design.parameters)
    # At the geometric mean of the references a location is the intercept.
    centre = new_cells(design, np.zeros(design.parameters), priors)
    slopes = []
    for term in design.fixed:
        weight = priors.gamma_sd if term.name == TREND else 0.0
        slopes += [weight * identity] * len(term.columns)
    rows = {}
    for number, name in enumerate(centre.cells.names):
        cell = centre.at(np.array([number]))
        intercepts = [np.diag(column) for column in cell_columns(cell.fixed)]
        rows[name] = np.block([intercepts, slopes])
    return rows


def cell_columns(terms: tuple[Term, ...]) -> list[Array]:
    """Columns (P,) of the terms of a design with one cell."""
    columns = []
    for term in terms:
        for column in term.columns:
            columns.append(column[:, 0])
    return columns


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
