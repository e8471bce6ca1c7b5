"""The linear design of a study: which columns join its cells, and which of them vary.

A cell is an environment at one level of every factor. There are P quantities p, C cells c, J
environments j, and subjects i. The location of a cell, a subject's setting in it, and its SD are

    beta_cp      = sum over fixed terms X_cp theta_p + sum over deviation terms X_cp zeta_jp
    setting_icp  = beta_cp + exp(h_cp) × sum over subject terms X_cp v_ip + w_icp
    log sigma_cp = m + sum over SD terms X_cp psi_p + omega_p e_cp,    sigma_cp the SD of w_icp
    h_cp         = sum over effect size terms X_cp eta_p

X are the columns of each term, (K, P, C). The coefficients theta and psi have known prior SDs,
which their columns are multiplied by. Each environment has deviations zeta, whose SD tau is
estimated for each term; each subject has effects v, whose covariance over the quantities is
estimated for each term. SDs between subjects and between trials have terms each.

A study of one cell shows the sum of v and w, and one SD: it has neither v nor psi, and its SD is
log sigma ~ N(m, s²), s the prior SD of the typical log sigma. Published limits show no v either.
"""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Iterable, Mapping

import numpy as np
from numpy.typing import NDArray
from scipy import linalg

from percept.inference.model.priors import Priors

Array = NDArray[np.float64]
Indices = NDArray[np.intp]

#: Name of the term whose column is one in every cell.
LEVEL = "level"
#: Name of the term whose column is the decades of the reference; one environment has none.
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
    between_subjects: frozenset[str] = frozenset()  # Factors of which a subject has one level only
    spread: tuple[str, ...] = ()  # Factors whose levels differ in the spread of subject effects
    subject_trends: bool = False  # Whether each subject has a trend over the references


@dataclasses.dataclass(frozen=True, kw_only=True)
class Options:
    """Simpler models."""

    subject_effect: bool = True  # Whether subjects have effects v that cells share
    weber: bool = False  # Log SDs have no trend (kappa = 0): SDs are in proportion to references
    common_spread: bool = False  # Log SDs follow their columns exactly (omega = 0)


@dataclasses.dataclass(frozen=True, eq=False)
class Term:
    """Columns of a term over the cells."""

    name: str
    columns: Array  # (K, P, C) Times the prior SD of their coefficients, where that is known
    prior: str = ""  # Field of `Priors` with this SD


@dataclasses.dataclass(frozen=True, eq=False)
class Design:
    """All terms of a study."""

    cells: Cells
    factors: Factors
    options: Options
    fixed: tuple[Term, ...]  # Of the locations
    deviation: tuple[Term, ...]  # Whose coefficients differ between environments
    subject: tuple[Term, ...]  # Whose coefficients differ between subjects
    sd_between: tuple[Term, ...]  # Of log sigma between subjects
    sd_trial: tuple[Term, ...]  # Of log sigma between trials
    effect_size: tuple[Term, ...]  # Of the log size of subject effects

    @property
    def parameters(self) -> int:
        """Number of quantities P."""
        return len(self.cells.x)

    @property
    def effects(self) -> int:
        """Number of effects of a subject."""
        return self.parameters * sum(len(term.columns) for term in self.subject)

    def identity(self) -> dict[str, object]:
        """Return what decides a density: cells and columns, since the columns hold the factors."""
        fields = dataclasses.asdict(self)
        del fields["factors"]
        return fields


def shows_subject_trends(present: NDArray[np.bool_], x: Array) -> bool:
    """Whether some subject meets three references of a quantity.

    Two are not enough: deviations of a subject's own in each environment hold any trend.

    Parameters
    ----------
    present : ndarray of bool
        Whether each subject has trials in each cell, shape (N, C).
    x : ndarray
        Decades of the references, shape (P, C).

    Returns
    -------
    bool
    """
    pairs = itertools.product(present, x)
    return any(len(np.unique(decades[cells])) > 2 for cells, decades in pairs)


def contrast_columns(levels: int) -> Array:
    """Orthogonal columns (levels, levels - 1) that sum to zero over the levels.

    Their squares sum to 1/2, so that a coefficient of prior SD s gives every difference of two
    levels the prior SD s. With two levels the column is (-1/2, 1/2).
    """
    return np.asarray(-linalg.helmert(levels).T / np.sqrt(2.0))


def design_of(
    cells: Cells,
    factors: Factors,
    priors: Priors,
    options: Options | None = None,
) -> Design:
    """Write out the columns of a study's terms.

    Parameters
    ----------
    cells : Cells
        The cells, with their environments and references.
    factors : Factors
        Levels of the cells, and terms.
    priors : Priors
        Prior SDs of all coefficients.
    options : Options, optional
        Simpler models.

    Returns
    -------
    Design
    """
    options = options or Options()
    several_environments = len(cells.environments) > 1
    level = Term(LEVEL, np.ones_like(cells.x)[None])
    trend = [Term(TREND, cells.x[None])] if several_environments else []
    effects = [_effect(cells, factors, names) for names in factors.terms]
    main_effects = [effect for effect in effects if effect.name in factors.levels]
    # A subject sees one level of the others, which therefore show no effect of the subject.
    within_subjects = [
        effect
        for effect, names in zip(effects, factors.terms, strict=True)
        if not factors.between_subjects.intersection(names)
    ]
    sd_terms: list[Term] = []
    subject_terms: list[Term] = []
    # A new environment is one of several, even if it has one cell.
    if len(cells.names) > 1 or several_environments:
        sd_trend = [] if options.weber else trend
        sd_terms = [level, *sd_trend, *main_effects]
        if options.subject_effect:
            subject_trend = trend if factors.subject_trends else []
            subject_terms = [level, *subject_trend, *within_subjects]
    sized_effects = [effect for effect in main_effects if effect.name in factors.spread]

    def scaled(terms: list[Term], other: str, **named: str) -> tuple[Term, ...]:
        """Multiply columns by the prior SDs of their coefficients."""
        found = []
        for term in terms:
            prior = named.get(term.name, other)
            columns = term.columns * getattr(priors, prior)
            found.append(Term(term.name, columns, prior))
        return tuple(found)

    return Design(
        cells=cells,
        factors=factors,
        options=options,
        fixed=scaled([level, *trend, *effects], "lambda_sd", level="alpha_sd", trend="gamma_sd"),
        # One environment cannot tell its deviation from the level.
        deviation=(level, *effects) if several_environments else (),
        subject=tuple(subject_terms),
        sd_between=scaled(sd_terms, "psi_sd", level="log_s_sd", trend="kappa_sd"),
        sd_trial=scaled(sd_terms, "psi_sd", level="log_s_e_sd", trend="kappa_e_sd"),
        effect_size=tuple(sized_effects),
    )


def _effect(
    cells: Cells,
    factors: Factors,
    factor_names: tuple[str, ...],
) -> Term:
    """Columns of a factor, or of an interaction: products of the columns of its factors."""
    columns_by_factor = []
    for name in factor_names:
        of_levels = contrast_columns(len(factors.levels[name]))
        of_cells = of_levels[factors.level[name]]
        columns_by_factor.append(of_cells.T)
    combinations = itertools.product(*columns_by_factor)
    products = [np.prod(columns, axis=0) for columns in combinations]
    shape = (len(products), *cells.x.shape)
    every_quantity = np.broadcast_to(np.stack(products)[:, None], shape)
    return Term(":".join(factor_names), every_quantity)


def new_cells(
    design: Design,
    x: Array,
    priors: Priors,
) -> Design:
    """Write out the columns of an untested environment, in every condition.

    A condition is a combination of levels, one of each factor, that some cell has.

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
    first_cell: dict[str, int] = {}
    for cell in range(len(cells.names)):
        names = [factors.levels[name][of_cells[cell]] for name, of_cells in factors.level.items()]
        condition = ", ".join(names)
        first_cell.setdefault(condition, cell)
    examples = np.array(list(first_cell.values()))
    added = Cells(
        names=tuple(first_cell),
        environment=np.full(len(examples), len(cells.environments)),
        environments=(*cells.environments, ""),
        x=np.repeat(x[:, None], len(examples), axis=1),
    )
    level = {name: of_cells[examples] for name, of_cells in factors.level.items()}
    return design_of(added, dataclasses.replace(factors, level=level), priors, design.options)


class Basis:
    """Locations of a design as combinations of latents.

    The latents are the own deviations of each environment, with SDs tau, and then r that are
    standard normal: coefficients of fixed terms over their prior SDs, and the same of slopes.

    Parameters
    ----------
    design : Design
        Of P quantities in C cells and J environments.
    covariates : int
        How many covariates have slopes.
    covariate_sd : float
        Prior SD of a slope.

    Attributes
    ----------
    own, fixed : ndarray
        Columns of own deviations, (a, P, C), and of fixed terms, (f, P, C).
    deviations : int
        Number a J of own deviations.
    matrix : ndarray
        Weights (R, a J + r) of the latents in R locations: cells by quantity, slopes of all
        quantities by covariate, and coefficients of fixed terms.
    """

    def __init__(
        self,
        design: Design,
        covariates: int,
        covariate_sd: float,
    ) -> None:
        x = design.cells.x
        environments = np.arange(len(design.cells.environments))
        self.own = columns_by_quantity(design.deviation, x)
        self.fixed = columns_by_quantity(design.fixed, x)
        self.deviations = len(self.own) * len(environments)
        inside = np.equal.outer(environments, design.cells.environment)
        own_apart = self.own[:, None] * inside[:, None]
        every = [*own_apart.reshape(-1, *x.shape), *self.fixed]
        of_cells = np.reshape(every, (len(every), -1)).T
        slopes = covariate_sd * np.eye(len(x) * covariates)
        cells_and_slopes = linalg.block_diag(of_cells, slopes)
        coefficients = np.eye(len(self.fixed), cells_and_slopes.shape[1], self.deviations)
        self.matrix = np.concatenate([cells_and_slopes, coefficients])

    def with_effects(
        self,
        effects: int,
        before: int,
    ) -> Array:
        """Add to `matrix` effects of subjects, which no location has, before some latent."""
        before_each = np.full(effects, before)
        return np.insert(self.matrix, before_each, 0.0, axis=1)


def columns_of(terms: Iterable[Term], x: Array) -> Array:
    """Columns (k, P, C) of terms in cells of decades x."""
    no_columns = np.zeros((0, *x.shape))
    return np.concatenate([no_columns, *(term.columns for term in terms)])


def columns_by_quantity(terms: Iterable[Term], x: Array) -> Array:
    """Columns (k P, P, C) of terms in cells of decades x, each for every quantity alone."""
    alone = columns_of(terms, x)[:, None] * np.eye(len(x))[..., None]
    return alone.reshape(-1, *x.shape)
