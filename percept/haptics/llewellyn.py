"""Llewellyn's criterion for the network of hand, device, coupling and environment (Eqs 1 to 4, 9, 10)."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from percept.errors import UsageError
from percept.haptics._arrays import ComplexArray, FloatArray, complex_array, nonnegative_array, ratio
from percept.haptics._search import local_minima
from percept.haptics._warp import checked_period
from percept.haptics.frequencies import covers_range, search_grid
from percept.haptics.impedance import coupling_admittance, device_impedance
from percept.haptics.impedance import hold as zero_order_hold
from percept.haptics.parameters import AnyDevice, Coupling, TabulatedDevice, refuse_arrays
from percept.haptics.poles import network_poles
from percept.haptics.stability import required_damping, stability_margin
from percept.notebook import NotebookRecord

ROUNDING = 1e-12
"""How near to 1 a margin, or the modulus of a pole, counts as on the limit."""

Verdict = Literal["stable", "marginal", "unstable", "undecided"]


@dataclass(frozen=True, eq=False)
class TwoPort:
    """A linear two-port in hybrid form, F₁ = p11·v₁ + p12·F₂, −v₂ = p21·v₁ + p22·F₂ (Eq. 1).

    Parameters
    ----------
    omega : array_like, shape (n,)
        rad/s.
    p11, p12, p21, p22 : array_like of complex, shape (n,)
        N·s/m, 1, 1 and m/(N·s).
    poles : array_like of complex, optional
        Poles in the z plane, each as often as its order; None where they are not known.

    Raises
    ------
    UsageError
        Where the lengths differ, an ω is negative or not finite, or a value is NaN.
    """

    omega: FloatArray
    p11: ComplexArray
    p12: ComplexArray
    p21: ComplexArray
    p22: ComplexArray
    poles: ComplexArray | None = None

    def __post_init__(self) -> None:
        omega = nonnegative_array(self.omega, "TwoPort omega", "rad/s")
        omega.flags.writeable = False
        object.__setattr__(self, "omega", omega)
        for name in ("p11", "p12", "p21", "p22"):
            value = complex_array(getattr(self, name), f"TwoPort {name}")
            if omega.ndim != 1 or value.shape != omega.shape or not omega.size:
                raise UsageError(
                    f"TwoPort {name} and omega must be of one length.", value=(value.shape, omega.shape)
                )
            object.__setattr__(self, name, value)
        if self.poles is not None:
            object.__setattr__(self, "poles", complex_array(self.poles, "TwoPort poles").ravel())


@dataclass(frozen=True, eq=False)
class AbsoluteStability(NotebookRecord):
    """Llewellyn's verdict, on stability with every passive hand and environment.

    Attributes
    ----------
    verdict : {"stable", "marginal", "unstable", "undecided"}
        Marginal where the smallest margin is 1 to within `rounding`; undecided where nothing speaks against
        stability, but the device's table leaves out a part of the range.
    reason : str
        The condition that decides, in one sentence.
    omega : ndarray, shape (n,)
        Where the margin was taken, rad/s; the verdict covers these, and what lies between them.
    margin : ndarray, shape (n,)
        2·Re p11·Re p22/(Re p12p21 + abs(p12p21)), at least 1 where stable; inf where nothing is asked for.
    smallest_margin : float
        The least of them.
    binding_omega : float
        Where it is, rad/s.
    poles : ndarray or None
        Poles in the z plane, None where they are not known.
    poles_allowed : bool or None
        Whether all poles lie inside the unit circle, or singly on it; None where they are not known.
    rounding : float
        How near to its limit a number counts as on it.
    """

    verdict: Verdict
    reason: str
    omega: FloatArray = field(repr=False)
    margin: FloatArray = field(repr=False)
    smallest_margin: float
    binding_omega: float
    poles: ComplexArray | None = field(repr=False)
    poles_allowed: bool | None
    rounding: float = ROUNDING


def two_port(
    omega: ArrayLike,
    device: AnyDevice,
    coupling: Coupling,
    period: float,
    *,
    discretization: str = "backward",
    hold: str = "average",
) -> TwoPort:
    """Return the network of Eq. 4: p11 = Z_d, p12 = ZOH, p21 = −1, p22 = 1/Z_c.

    Parameters
    ----------
    omega : array_like, shape (n,)
        rad/s, 0 to π/T.
    device : Device or TabulatedDevice
        The device, Z_d; of a table the poles are not known.
    coupling : Coupling
        One coupling, Z_c.
    period : float
        Sampling period T, s.
    discretization : {"backward", "tustin"}
        Eq. 6 (default), or Eq. 12's form.
    hold : {"average", "true"}
        Eq. 8, or the true zero-order hold.

    Returns
    -------
    TwoPort

    Raises
    ------
    UsageError
        ω negative, above Nyquist or outside a device's table, T not positive, arrays as parameters, an
        unknown hold or discretization.
    """
    refuse_arrays(device, coupling)
    omega = np.atleast_1d(nonnegative_array(omega, "omega", "rad/s"))
    return TwoPort(
        omega=omega,
        p11=device_impedance(omega, device, period),
        p12=zero_order_hold(omega, period, kind=hold),
        p21=np.full(omega.shape, -1.0 + 0j),
        p22=coupling_admittance(omega, coupling, period, discretization=discretization),
        poles=network_poles(device, coupling, checked_period(period), discretization),
    )


def llewellyn(network: TwoPort) -> AbsoluteStability:
    """Judge a two-port by Llewellyn's conditions at its own ω, poles included (Eqs 2, 3).

    Parameters
    ----------
    network : TwoPort
        Any linear two-port.

    Returns
    -------
    AbsoluteStability
        Only the network's own ω are seen; `absolute_stability` searches all ω of a device and coupling.
    """
    product_real = network.p12.real * network.p21.real - network.p12.imag * network.p21.imag
    product_imag = network.p12.real * network.p21.imag + network.p12.imag * network.p21.real
    size = np.hypot(product_real, product_imag)
    # Re x + |x| = Im²/(|x| − Re x) where Re x < 0: at low ω the sum itself would cancel to nothing.
    negative = product_real < 0
    asked = np.where(
        negative,
        product_imag * ratio(product_imag, np.where(negative, size - product_real, 1.0), empty=0.0),
        product_real + size,
    )
    r11, r22 = network.p11.real, network.p22.real
    # An active port must not be mended by the other's sign.
    with np.errstate(invalid="ignore"):
        given = np.where((r11 < 0) | (r22 < 0), -np.abs(2 * r11 * r22), 2 * r11 * r22)
    # Without a coupling the device is joined to nothing, and need not dissipate.
    given = np.where(np.isinf(r22) & (r11 >= 0) & (r22 > 0), np.inf, given)
    margin = ratio(given, asked, empty=np.inf)
    return _judged(network.omega, margin, network.poles)


def absolute_stability(
    device: AnyDevice,
    coupling: Coupling,
    period: float,
    *,
    discretization: str = "backward",
    hold: str = "average",
) -> AbsoluteStability:
    """Judge a device with a coupling at every ω from DC to Nyquist, poles included (Eqs 9, 10).

    A rigid device is judged in closed form. With modes the smallest margin is searched on a grid that
    resolves each mode, and refined; a table is searched over the range it covers, and cannot show stability
    where that is not all of it.

    Parameters
    ----------
    device : Device or TabulatedDevice
        The device, Z_d.
    coupling : Coupling
        One coupling, Z_c.
    period : float
        Sampling period T, s.
    discretization : {"backward", "tustin"}
        Eq. 6 (default), or Eq. 12's form.
    hold : {"average", "true"}
        Eq. 8, or the true zero-order hold.

    Returns
    -------
    AbsoluteStability

    Raises
    ------
    UsageError
        T not positive, arrays as parameters, a table that begins above Nyquist, an unknown hold or
        discretization.
    """
    period = checked_period(period)
    refuse_arrays(device, coupling)
    need = required_damping(coupling, period, discretization=discretization, hold=hold)

    def margin(omega: FloatArray) -> FloatArray:
        return np.asarray(
            stability_margin(omega, device, coupling, period, discretization=discretization, hold=hold)
        )

    omega = search_grid(device, period, float(need.omega))
    if isinstance(device, TabulatedDevice) or device.modes:
        omega = np.union1d(omega, local_minima(margin, omega))
        margins = margin(omega)
    else:
        margins = margin(omega)
        # The closed form is exact where the margin at its rounded ω is only as good as that ω.
        margins[omega == need.omega] = ratio(device.damping, need.damping, empty=np.inf)
    found = _judged(omega, margins, network_poles(device, coupling, period, discretization))
    if found.verdict != "unstable" and not covers_range(device, period):
        assert isinstance(device, TabulatedDevice)
        reason = (
            f"From {device.omega[0]:.6g} to {device.omega[-1]:.6g} rad/s the smallest margin is "
            f"{found.smallest_margin:.6g}; of the rest, up to {np.pi / period:.6g} rad/s, the device's table "
            "says nothing."
        )
        return replace(found, verdict="undecided", reason=reason)
    return found


def _poles_allowed(poles: ComplexArray) -> bool:
    """Say whether all poles are inside the unit circle or singly on it."""
    size = np.abs(poles)
    if (size > 1 + ROUNDING).any():
        return False
    on = poles[np.abs(size - 1) <= ROUNDING]
    return len(np.unique(on)) == len(on)


def _judged(omega: FloatArray, margin: FloatArray, poles: ComplexArray | None) -> AbsoluteStability:
    """Turn margins and poles into a verdict."""
    least = int(np.argmin(margin))
    smallest, binding = float(margin[least]), float(omega[least])
    allowed = None if poles is None else _poles_allowed(poles)
    verdict: Verdict = "stable"
    reason = f"The smallest margin is {smallest:.6g}, at {binding:.6g} rad/s."
    if allowed is False:
        verdict, reason = (
            "unstable",
            "The network has a pole outside the unit circle, or a multiple one on it.",
        )
    elif smallest < 1 - ROUNDING:
        verdict = "unstable"
        if smallest < 0:
            reason = f"A port is active: its real part is negative at {binding:.6g} rad/s."
    elif smallest <= 1 + ROUNDING:
        verdict = "marginal"
    return AbsoluteStability(
        verdict=verdict,
        reason=reason,
        omega=omega,
        margin=margin,
        smallest_margin=smallest,
        binding_omega=binding,
        poles=poles,
        poles_allowed=allowed,
    )
