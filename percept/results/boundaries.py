"""Realistic performance boundaries over omega, and how wide the band between them is."""

from __future__ import annotations

import dataclasses
from typing import Literal, TypeAlias

from percept.html import NotebookRecord
from percept.inference.record import Family, Kind, Method
from percept.results.fields import Array

Shape: TypeAlias = Literal["corner", "envelope", "pointwise", "simultaneous"]


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Boundary(NotebookRecord):
    """Lower and upper curve of abs(Z_h) over omega that feel like one environment.

    Attributes
    ----------
    environment : str
        The reference condition.
    kind : str
        What is covered: "mean", "user" or "share".
    method, family, joint : str
        How the region or the draws behind it were made.
    shape : str
        "corner": both lower limits together and both upper together (Eqs 16-17); the curves can
        cross. "envelope": exact smallest and largest magnitude over the region. "pointwise":
        equal-tailed limits of the law of (k, b) at each omega. "simultaneous": limits between which
        whole curves lie with probability `level`; they contain the pointwise ones. Bayesian:
        pointwise limits at a higher level. Classical: those joined with the envelope of Hotelling's
        ellipse; for normal users at least the level.
    level : float
        Level of the region, or of the curves.
    omega : ndarray, shape (M,)
        rad/s.
    lower, upper : ndarray, shape (M,)
        N·s/m.
    reference : ndarray, shape (M,)
        abs(Z_h) of the reference environment, without coupling, N·s/m.
    coupled : ndarray, shape (M,), or None
        abs(Z_h) of the reference through the virtual coupling (Eq. 11), N·s/m.
    errors : ndarray, shape (2, M), or None
        Monte Carlo standard errors of log lower and log upper, from batches of posterior draws;
        None where nothing is drawn.
    error : float or None
        Typical `errors` (root mean square over log omega), as a fraction of half the band's width
        in logarithms. None without errors, and without width.
    pointwise_level, pointwise_level_error : float or None
        Of a Bayesian simultaneous boundary: the level of its limits at each omega, and its Monte
        Carlo error. With a posterior of the device that error is of the device at its point.
    device_share : float or None
        Share of the squared width, in logarithms, that not knowing the device makes: a mean over
        log omega. None where the device is at its point.
    """

    environment: str
    kind: Kind
    method: Method
    family: Family
    joint: str
    shape: Shape
    level: float
    omega: Array
    lower: Array
    upper: Array
    reference: Array
    coupled: Array | None = None
    errors: Array | None = None
    error: float | None = None
    pointwise_level: float | None = None
    pointwise_level_error: float | None = None
    device_share: float | None = None

    @property
    def band(self) -> Array:
        """Upper minus lower, N·s/m; negative where corner curves have crossed."""
        return self.upper - self.lower


@dataclasses.dataclass(frozen=True)
class Coefficient(NotebookRecord):
    """A parameter of a law with its interval."""

    value: float
    lower: float
    upper: float


@dataclasses.dataclass(frozen=True, kw_only=True)
class BandRow:
    """Width of one environment's interval of users against the environment's own size."""

    environment: str
    method: Method
    family: Family
    impedance: float | None = None  # abs(Z_e) in N·s/m; None where the size is a reference
    reference: float | None = None  # In the parameter's unit; None where the size is an impedance
    parameter: str | None = None  # None for the band of abs(Z_e)
    lower: float
    upper: float
    band: float  # Upper minus lower
    #: Its own limits, over posterior draws or a parametric bootstrap; None where no law is fitted.
    band_lower: float | None = None
    band_upper: float | None = None
    relative: float  # Over the environment's size


@dataclasses.dataclass(frozen=True, kw_only=True)
class BandLaw(NotebookRecord):
    """A law fitted to bands over environments."""

    method: Method
    family: Family
    parameter: str | None = None  # Whose bands lie against its own reference; None for abs(Z_e)
    model: str  # "weber": w|Z|, "offset": c + w|Z|, "power": w|Z|^p
    parameters: dict[str, Coefficient]  # By name: c, w, p
    level: float  # Of the parameters' intervals: of posterior draws, or of a parametric bootstrap
    sentence: str  # What the law says
    left_out_error: float  # Typical error of the logarithm of a band left out
    best: float  # Share of the draws in which this law has the smallest such error of the three
    carried_by: str | None = None  # The one environment without which the offset all but vanishes


@dataclasses.dataclass(frozen=True, kw_only=True)
class BandStatement(NotebookRecord):
    """A statement on bands, with the probability that it is true."""

    method: Method
    family: Family
    parameter: str | None = None
    statement: str  # In words
    probability: float  # Share of the posterior draws, or of the bootstrap's


@dataclasses.dataclass(frozen=True, kw_only=True)
class WeberTrend:
    """The slope of log spread against the logarithm of the reference: zero under Weber's law."""

    parameter: str
    lower: float
    value: float
    upper: float
    below_zero: float  # Posterior probability of a negative slope


@dataclasses.dataclass(frozen=True)
class Band(NotebookRecord):
    """Bands of the device-free environment impedance, or of other quantities, and their laws."""

    omega: float | None  # rad/s; None where the quantities make no impedance
    rows: tuple[BandRow, ...]
    laws: tuple[BandLaw, ...]  # Three per method and family, with at least three environments
    statements: tuple[BandStatement, ...] = ()
    kappa: tuple[WeberTrend, ...] | None = None
