"""Boundaries and bands; what feels real, directly and through the coupling; couplings' maps."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any, Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray
from pydantic import PlainValidator

from percept.html import NotebookRecord
from percept.inference.record import Family, Kind, Method
from percept.results.data import Note

Shape: TypeAlias = Literal["corner", "envelope", "pointwise", "simultaneous"]
Feeling: TypeAlias = Literal["feels real", "does not", "too little data"]
Inside: TypeAlias = Literal["inside", "marginal", "outside"]
#: Environments that a page draws, with their curves and couplings; its tables hold more.
MOST_SHOWN = 10
#: Whether a device renders with every passive hand.
Rendering: TypeAlias = Literal["can", "cannot", "undecided"]


def _as_floats(values: Any) -> NDArray[np.float64]:
    """Read a list of a document: "inf" is infinite, and None is NaN."""
    if not isinstance(values, (list, np.ndarray)):
        raise ValueError("a list of numbers was expected")
    return np.asarray(values, dtype=np.float64)


#: An array of doubles; in JSON a list, or a list of lists.
Array = Annotated[NDArray[np.float64], PlainValidator(_as_floats)]


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
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
    error : float or None
        Typical Monte Carlo standard error of log lower and log upper (root mean square over log
        omega), as a fraction of half the band's width in logarithms. None where nothing is drawn,
        and without width.
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
    error: float | None = None
    device_share: float | None = None

    @property
    def band(self) -> Array:
        """Upper minus lower, N·s/m; negative where corner curves have crossed."""
        return self.upper - self.lower


@dataclass(frozen=True)
class Coefficient(NotebookRecord):
    """A parameter of a law with its interval."""

    value: float
    lower: float
    upper: float


@dataclass(frozen=True, kw_only=True)
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


@dataclass(frozen=True, kw_only=True)
class BandLaw(NotebookRecord):
    """A law fitted to bands over environments."""

    method: Method
    family: Family
    parameter: str | None = None  # Whose bands lie against its own reference; None for abs(Z_e)
    model: str  # "weber": w|Z|, "offset": c + w|Z|, "power": w|Z|^p
    #: By name: c, w, p; intervals are of posterior draws, or of a parametric bootstrap.
    parameters: dict[str, Coefficient]
    sentence: str  # What the law says
    left_out_error: float  # Typical error of the logarithm of a band left out
    best: float  # Share of the draws in which this law has the smallest such error of the three


@dataclass(frozen=True, kw_only=True)
class WeberTrend:
    """The slope of log spread against the logarithm of the reference: zero under Weber's law."""

    parameter: str
    lower: float
    value: float
    upper: float
    below_zero: float  # Posterior probability of a negative slope


@dataclass(frozen=True)
class Band(NotebookRecord):
    """Bands of the device-free environment impedance, or of other quantities, and their laws."""

    omega: float | None  # rad/s; None where the quantities make no impedance
    rows: tuple[BandRow, ...]
    laws: tuple[BandLaw, ...]  # Three per method and family, with at least three environments
    kappa: tuple[WeberTrend, ...] | None = None


@dataclass(frozen=True)
class CentralProbability:
    """Posterior probability that a display lies among a central share of users at every ω."""

    central: float
    probability: float


@dataclass(frozen=True, kw_only=True)
class PosteriorEvidence:
    """Posterior probability that a display lies in the central range of users at every ω.

    Where the scene's device has a posterior, each draw of the users has a device of its own.
    """

    outcome: Feeling
    probability: float  # By abs(Z_h) and by effective stiffness and damping
    error: float  # Its Monte Carlo standard error
    draws: int
    straddles: bool  # Whether two errors reach over a threshold after all draws
    magnitude: float  # By abs(Z_h) alone
    plane: float  # By effective stiffness and damping alone
    by_central: tuple[CentralProbability, ...]  # Against other shares of users
    lowest_omega: float  # Where abs(Z_h) is least probable, rad/s; of many devices, the median


@dataclass(frozen=True, kw_only=True)
class Confidences:
    """Classical confidence that what is displayed lies in the central range of users, by parts."""

    outcome: Feeling
    family: Family
    probability: float  # What is compared with the decision: the least of the parts below
    stiffness: float  # At the omega least favourable to it
    damping: float
    magnitude: float | None  # Of abs(Z_h); None with fewer than three subjects
    magnitude_omega: float | None  # Where it is least, rad/s
    together: float | None  # That all parts hold at every omega
    together_error: float | None  # Its Monte Carlo standard error


@dataclass(frozen=True, kw_only=True)
class MoreSubjects(NotebookRecord):
    """How many more subjects would decide a verdict with a stated probability."""

    subjects: int | None  # None where `most` are not enough
    assurance: float  # That probability
    most: int  # Subjects beyond which no number is given


@dataclass(frozen=True, kw_only=True)
class Leaning:
    """The doubtful rows of an environment, and its verdict without any doubtful row."""

    rows: tuple[Note, ...]  # Each with its value and what lets one doubt it
    without: Verdict | None  # None where the rest carries no verdict


@dataclass(frozen=True, kw_only=True)
class Verdict(NotebookRecord):
    """Whether one environment, as it is displayed, feels real."""

    environment: str
    coupled: bool  # Through the coupling, or directly
    central: float  # Share of all users that a central range holds
    decision: float  # It feels real from this probability on, and does not from one minus it down
    subjects: int  # Of fewer than six, abs(Z_h) alone never says "does not"
    outcome: Feeling  # Of `method`
    method: Method  # Bayesian where there is a posterior
    probability: float  # Posterior probability, or the classical method's least confidence
    bayesian: PosteriorEvidence | None
    classical: Confidences | None
    stable_and_real: float | None  # None where rendering is undecided, and without draws
    # None where either method decides, and without a joint law of the subjects' values.
    more: MoreSubjects | None = None
    leaning: Leaning | None = None  # None where no row of the environment looks mistyped
    #: Posterior probability without each subject, in the order of `LeftOut`; None where the draws
    #: do not tell. Empty without checks, and of many environments in all but the first.
    without: tuple[float | None, ...] = ()


@dataclass(frozen=True, kw_only=True, eq=False)
class RenderedEdge:
    """Edge of the stiffness and damping that a device renders with every passive hand, in time."""

    stiffness: Array  # (M,) From no damping to no stiffness, N/m
    damping: Array  # (M,) Beside each stiffness, N·s/m
    stiffest: float  # Largest stiffness of all, N/m
    stiffest_damping: float  # Beside which it is reached, N·s/m
    most_damping: float  # Largest damping, N·s/m


@dataclass(frozen=True)
class RenderedWall:
    """An environment beside the edges."""

    environment: str
    stiffness: float  # N/m
    damping: float  # N·s/m


@dataclass(frozen=True, kw_only=True, eq=False)
class ZWidth(NotebookRecord):
    """What a device renders with every passive hand, in time.

    The edge holds for walls rendered directly, and for couplings with a rigid wall behind them.
    """

    edge: RenderedEdge | None  # None where a device's table does not tell
    references: tuple[RenderedWall, ...]
    likely: RenderedEdge | None = None  # Of 95 % of a posterior's devices, by their damping alone


@dataclass(frozen=True, kw_only=True)
class Membership:
    """The paper's rule: whether a reference stays inside a boundary, directly and coupled."""

    environment: str
    method: Method
    kind: Kind  # The next user where such intervals were asked for
    family: Family
    verdict_uncoupled: Inside
    verdict_coupled: Inside


@dataclass(frozen=True, kw_only=True)
class DeviceStability(NotebookRecord):
    """How probably the device renders: all of the uncertainty is the device's."""

    probability: float
    error: float  # Its Monte Carlo standard error, as of independent draws
    draws: int  # Devices from the posterior of the scene


@dataclass(frozen=True, kw_only=True)
class Rendered(NotebookRecord):
    """Whether the device renders one environment with every passive hand, in time."""

    environment: str | None  # None for a rigid wall behind the coupling
    coupled: bool  # Through the coupling, or directly
    verdict: Rendering
    reason: str  # What decides
    needed_damping: float  # That a rigid device needs, N·s/m
    margin: float  # Smallest ratio of what the device dissipates to what is asked for
    binding_omega: float  # Where the margin is least, rad/s
    by_device: DeviceStability | None = None  # None where the scene's device has no posterior

    @property
    def stable(self) -> bool | None:
        """Whether no passive hand makes the motion grow; None where that is undecided."""
        return {"can": True, "cannot": False}.get(self.verdict)


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Coupling(NotebookRecord):
    """The coupling by the paper: Eq. 10, and its rule for boundaries.

    Eq. 10 leaves out that forces alias: it does not say what a sampled loop renders. `Rendered`
    does.
    """

    stiffness: float  # Of the coupling, N/m
    damping: float  # Of the coupling, N·s/m
    eq10: str  # "met", "on its limit", "not met" or "undecided", over all ω
    eq10_reason: str
    eq10_margin: float  # Smallest ratio of Re Z_d to what Eq. 10 asks for
    eq10_omega: float  # Where it binds, rad/s
    required_damping: float | None  # By Eq. 10 of a rigid device, N·s/m; None for other devices
    omega: Array  # (M,) Frequencies of Fig. 4, rad/s
    bound: Array  # (M,) Eq. 10's bound there
    admittance: Array  # (M,) Real part of the coupling's admittance there
    memberships: tuple[Membership, ...]  # By the paper's rule, one per environment


@dataclass(frozen=True, kw_only=True)
class ConfirmedCoupling(NotebookRecord):
    """A coupling that is stable in time and was found to feel real at every omega of the range."""

    stiffness: float  # k_c, N/m
    damping: float  # b_c, N·s/m
    probability: float  # That it feels real; of several at once, where it is least probable
    error: float  # Its Monte Carlo standard error
    draws: int
    #: What a coupling beyond breaks first: stability, or the less probable of two parts. At the end
    #: of the map nothing breaks.
    bound: Literal["stability", "magnitude", "plane", "map"]


@dataclass(frozen=True, kw_only=True, eq=False)
class EnvironmentCouplings:
    """How probably stable couplings feel real in one environment."""

    name: str
    damping: Array  # (B,) b_c of each line, N·s/m
    stiffness: Array  # (B, K) k_c on each line of damping, N/m
    probability: Array  # (B, K) Zero where a coupling is not stable in time
    limited: bool  # Whether stability ends the map; else couplings count as rigid from there on
    outcome: Literal["some", "none", "undecided"]  # Whether couplings are admissible
    draws: int  # Behind the map; its ends are confirmed by more
    stiffest: ConfirmedCoupling | None  # None where no coupling surely reaches the decision
    softest: ConfirmedCoupling | None


@dataclass(frozen=True, kw_only=True, eq=False)
class AdmissibleCouplings(NotebookRecord):
    """Couplings that are stable in time, with the probability that they feel real.

    Where the device has a posterior, with the probability that they are stable and, with the device
    at its point, feel real.
    """

    method: Method  # Whose draws of the users these are
    decision: float  # A coupling is admissible two errors above this probability
    environments: tuple[EnvironmentCouplings, ...]
    devices: int | None = None  # Behind P(stable); None where the device has no posterior
    #: An end of a map that serves all environments which some coupling serves
    together: ConfirmedCoupling | None = None


@dataclass(frozen=True, kw_only=True)
class ChangedVerdict:
    """A display on each of the `OtherDevices`."""

    environment: str
    coupled: bool  # Whether through the scene's coupling
    probability: tuple[float, ...]  # That it feels real
    rendered: tuple[bool, ...]  # Whether with every passive hand, in time


@dataclass(frozen=True, kw_only=True)
class OtherDevices(NotebookRecord):
    """Verdicts with the scene's device, half and 1.5 times its mass, then its damping."""

    mass: tuple[float, ...]  # kg
    damping: tuple[float, ...]  # N·s/m
    coupled: bool  # Whether the scene has a coupling
    verdicts: tuple[ChangedVerdict, ...]  # Of what one of these devices renders
    method: Method  # Whose draws of the users these are
    draws: int  # At least: where these decide nothing there are up to four times as many
