"""What the published study concludes, each conclusion as a statement with its margin.

The limits are those of the paper: t-intervals of the mean, normal family (Eq. 15). Where device and coupling
matter they are the scene's, since the paper's device was never published.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from percept import haptics
from percept.boundary.band import environment_magnitude_range
from percept.boundary.membership import magnitude_membership
from percept.errors import RefusalError
from percept.study.boundaries import Bench
from percept.study.cells import Limits, both_limits

if TYPE_CHECKING:
    from percept.study.study import Study

__all__ = ["PaperClaim", "paper_claims"]

Array = NDArray[np.float64]
_NAMES = ("VE1", "VE2", "VE3", "VE4", "VE5")
_OMEGA = 10.0  # rad/s, where the paper looks closely
_WINDOW = (9.9, 10.1)  # rad/s, of Fig. 7d
_HEAVIEST = 1000.0  # kg


@dataclasses.dataclass(frozen=True)
class PaperClaim:
    """A conclusion of the published study, tested.

    Attributes
    ----------
    topic : str
        What it is about, in a few words.
    statement : str
        What is claimed.
    holds : bool
        Whether the data and the scene's device bear it out.
    margin : float
        By how much, in the terms of `meaning`: positive where it holds, negative where it fails.
    meaning : str
        What the margin is.
    """

    topic: str
    statement: str
    holds: bool
    margin: float
    meaning: str


@dataclasses.dataclass(frozen=True, eq=False)
class _Published:
    bench: Bench
    coupling: haptics.Coupling
    device: haptics.Device
    limits: dict[str, tuple[Limits, Limits]]

    def reference(self, name: str) -> tuple[float, float]:
        environment = self.bench.references[name]
        return float(environment.stiffness), float(environment.damping)

    def coupled_stiffness(self, name: str) -> float:
        """Stiffness of environment and coupling in series at rest, N/m."""
        k, k_c = self.reference(name)[0], float(self.coupling.stiffness)
        return k * k_c / (k + k_c)


def paper_claims(study: Study) -> tuple[PaperClaim, ...]:
    """Test the conclusions of the published study.

    Parameters
    ----------
    study : Study
        Of the published limits, or of sessions like them: VE1 to VE5, a rigid device, a coupling.

    Returns
    -------
    tuple of PaperClaim
        In the order of the paper's discussion.

    Raises
    ------
    RefusalError
        Without those environments, a rigid device and a coupling.
    """
    bench = study.bench
    if bench is None or bench.coupling is None or not isinstance(bench.device, haptics.Device):
        raise RefusalError("the paper's conclusions need a rigid device and a coupling in the scene.")
    rows = study.intervals
    rows = rows[(rows["method"] == "classical") & (rows["kind"] == "mean")]
    rows = rows[(rows["family"] == "normal") & (rows["joint"] == "marginal")]
    limits = {str(name): both_limits(part) for name, part in rows.groupby("environment", sort=False)}
    known = {name: found for name, found in limits.items() if found is not None}
    if not set(_NAMES) <= set(known):
        raise RefusalError(
            f"the paper's conclusions are about {', '.join(_NAMES)}; the data have {', '.join(known)}.",
            hint='Analyse the published table or sessions like it, with method = "both" or "classical".',
        )
    data = _Published(bench, bench.coupling, bench.device, known)
    return (
        *_inside_at_low_impedance(data),
        *_outside_at_high_impedance(data),
        *_suitability(data),
        *_always_smaller(data),
        _stability(data),
        *_discrimination(data),
        *_phase(data),
    )


def _claim(topic: str, statement: str, margin: float, meaning: str) -> PaperClaim:
    return PaperClaim(topic, statement, margin >= 0, float(margin), meaning)


def _inside_at_low_impedance(data: _Published) -> list[PaperClaim]:
    def depth(mass: float) -> float:
        bench = dataclasses.replace(data.bench, device=dataclasses.replace(data.device, mass=mass))
        omega = np.linspace(*_WINDOW, 41)
        lower, upper = haptics.corner_curves(
            omega, bench.device, *data.limits["VE2"], bench.period, hold=bench.hold
        )
        curves = [bench.curve("VE2", omega, coupled=coupled) for coupled in (False, True)]
        return min(magnitude_membership(omega, lower, upper, curve).margin for curve in curves)

    window = f"{_WINDOW[0]:g} to {_WINDOW[1]:g} rad/s"
    (k_low, k_high), _ = data.limits["VE2"]
    k = data.coupled_stiffness("VE2")
    found = [
        _claim(
            "VE2, Fig. 7d",
            f"With the scene's device Z_h and Z_h_vc both lie inside the boundaries from {window}.",
            depth(float(data.device.mass)),
            "log of the ratio to the nearer limit",
        ),
        _claim(
            "VE2, stiffness through the coupling",
            f"The stiffness felt, {k:.6g} N/m, lies inside {k_low:.6g} to {k_high:.6g} N/m.",
            min(k / k_low, k_high / k) - 1.0,
            "distance to the nearer limit, relative",
        ),
    ]
    if depth(0.0) >= 0:
        heaviest = _largest(depth, _HEAVIEST)
        found.append(
            _claim(
                "VE2, Fig. 7d",
                f"This holds for a device of the scene's damping up to {heaviest:.4g} kg.",
                heaviest - float(data.device.mass),
                "kg above the scene's mass",
            )
        )
    return found


def _outside_at_high_impedance(data: _Published) -> list[PaperClaim]:
    k_ref, (_, k_high) = data.reference("VE4")[0], data.limits["VE4"][0]
    found = [
        _claim(
            "VE4, Fig. 7f",
            f"The reference stiffness {k_ref:.6g} N/m lies above the upper limit {k_high:.6g} N/m.",
            k_ref / k_high - 1.0,
            "excess over the limit, relative",
        )
    ]
    for name in ("VE4", "VE3", "VE5"):
        k, (k_low, _) = data.coupled_stiffness(name), data.limits[name][0]
        found.append(
            _claim(
                f"{name}, stiffness through the coupling",
                f"The stiffness felt, {k:.6g} N/m, lies below the lower limit {k_low:.6g} N/m.",
                1.0 - k / k_low,
                "shortfall below the limit, relative",
            )
        )
    return found


def _suitability(data: _Published) -> list[PaperClaim]:
    omega = np.array([_OMEGA])
    loss = {
        name: 1.0
        - float(
            data.bench.curve(name, omega, coupled=True)[0] / data.bench.curve(name, omega, coupled=False)[0]
        )
        for name in ("VE1", "VE5")
    }
    return [
        _claim(
            "coupling and impedance",
            f"At {_OMEGA:g} rad/s the coupling takes away less of abs(Z_h) at high impedance (VE5, "
            f"{loss['VE5']:.3%}) than at low (VE1, {loss['VE1']:.3%}), so it suits high impedance only.",
            loss["VE1"] - loss["VE5"],
            "difference of the shares taken away",
        )
    ]


def _always_smaller(data: _Published) -> list[PaperClaim]:
    bench = data.bench
    omega = np.geomspace(0.1, 100.0, 601)
    felt, shown = [], []
    for name in _NAMES:
        reference = bench.references[name]
        own = np.abs(haptics.environment_impedance(omega, reference, bench.period))
        felt.append(bench.curve(name, omega, coupled=True) / own)
        effective = haptics.effective_impedance(omega, reference, data.coupling, bench.period)
        shown.append(np.abs(effective.value) / own)
    j, m = np.unravel_index(int(np.argmax(felt)), (len(_NAMES), omega.size))
    return [
        _claim(
            "smaller through a coupling",
            "abs(Z_h_vc) is smaller than abs(Z_e) for every environment and omega; it is most above for "
            f"{_NAMES[j]} at {omega[m]:.4g} rad/s, where the device's own impedance leads.",
            1.0 - float(np.max(felt)),
            "1 less the largest ratio, 0.1 to 100 rad/s",
        ),
        _claim(
            "smaller through a coupling",
            "abs(Z_eff), environment and coupling without the device, is smaller than abs(Z_e).",
            1.0 - float(np.max(shown)),
            "1 less the largest ratio, 0.1 to 100 rad/s",
        ),
    ]


def _stability(data: _Published) -> PaperClaim:
    bench = data.bench
    found = haptics.absolute_stability(bench.device, data.coupling, bench.period, hold=bench.hold)
    return _claim(
        "absolute stability",
        "The coupling is absolutely stable with the scene's device; binding at "
        f"{float(found.binding_omega):.5g} rad/s.",
        float(found.smallest_margin) - 1.0,
        "device damping over what is required, less 1",
    )


def _discrimination(data: _Published) -> list[PaperClaim]:
    widths, impedance = [], []
    for name in _NAMES:
        lower, upper = environment_magnitude_range(_OMEGA, *data.limits[name])
        k, b = data.reference(name)
        impedance.append(float(np.hypot(b, k / _OMEGA)))
        widths.append(float(upper - lower))
    relative = np.array(widths) / np.array(impedance)
    listed = ", ".join(f"{share:.1%}" for share in relative)
    return [
        _claim(
            "discrimination, absolute",
            f"The band of abs(Z_e) at {_OMEGA:g} rad/s is narrower at the lowest impedance than at the "
            "highest.",
            widths[-1] - widths[0],
            "difference of the widths, N·s/m",
        ),
        _claim(
            "discrimination, relative",
            f"So is the band relative to the impedance ({listed}).",
            float(relative[-1] - relative[0]),
            "difference of the relative widths",
        ),
    ]


def _phase(data: _Published) -> list[PaperClaim]:
    k, b = data.reference("VE2")
    (k_low, k_high), (b_low, b_high) = data.limits["VE2"]
    size = float(np.hypot(b, k / _OMEGA))
    lower, upper = (float(np.hypot(*pair)) for pair in ((b_low, k_low / _OMEGA), (b_high, k_high / _OMEGA)))
    return [
        _claim(
            "VE2, magnitude",
            f"abs(Z_e) of the reference at {_OMEGA:g} rad/s lies between those of the limits.",
            min(size / lower, upper / size) - 1.0,
            "distance to the nearer limit, relative",
        ),
        _claim(
            "VE2, damping",
            f"So does its damping, {b:g} N·s/m, between {b_low:.6g} and {b_high:.6g} N·s/m.",
            min(b / b_low, b_high / b) - 1.0,
            "distance to the nearer limit, relative",
        ),
    ]


def _largest(depth: Callable[[float], float], most: float) -> float:
    """Return the largest argument up to which `depth` stays positive, by bisection of its first change."""
    low, high = 0.0, 1.0
    while depth(high) >= 0 and high < most:
        low, high = high, 2.0 * high
    for _ in range(60):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if depth(middle) >= 0 else (low, middle)
    return low
