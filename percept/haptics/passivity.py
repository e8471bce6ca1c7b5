"""Device damping that direct rendering needs to be passive at its one port, in two models."""

from __future__ import annotations

import numpy as np

from percept.haptics._arrays import FloatArray, one_of
from percept.haptics._warp import checked_period
from percept.haptics.parameters import Environment

MODELS = ("colgate", "tustin")


def passivity_damping(environment: Environment, period: float, *, model: str = "colgate") -> FloatArray:
    """Return the device damping above which an environment rendered without coupling is passive.

    Parameters
    ----------
    environment : Environment
        Its parameters may be arrays.
    period : float
        Sampling period T, s.
    model : {"colgate", "tustin"}
        "colgate": true zero-order hold and backward differences (Colgate & Schenkel), b_d > k·T/2 + abs(b)
        for an environment without mass. "tustin": the averaging hold and Tustin's method (Eqs 7, 8),
        b_d ≥ k·T/2 − b, whatever the mass.

    Returns
    -------
    ndarray
        N·s/m, of the environment's shape; a negative value is met by every device.

    Raises
    ------
    UsageError
        T not positive, an unknown model.

    Notes
    -----
    Colgate and Schenkel ask b_d > T/(2(1 − cos θ))·Re[(1 − e^{−jθ})·H(e^{jθ})] for all θ = ωT. With
    u = sin²(θ/2) and backward differences throughout, the right-hand side is
    k·T/2 − b(1 − 2u) − (2m/T)(3u − 4u²): convex in u, so largest at DC, k·T/2 − b, or at Nyquist,
    k·T/2 + b + 2m/T. In the paper's own model
    Re Z_h = b_d + cos²(θ/2)(b − k·T/2) + (2m/T)·sin²(θ/2), smallest at DC where it can be negative at all.
    """
    one_of(model, "model", MODELS)
    period = checked_period(period)
    k, b, m = (np.asarray(part) for part in (environment.stiffness, environment.damping, environment.mass))
    elastic = k * (period / 2)
    if model == "colgate":
        return (elastic + b + m * (2 / period))[()]
    return (elastic - b + 0.0 * m)[()]
