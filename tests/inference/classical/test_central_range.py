"""The confidence of lying in the central range: against quadrature, and in simulated studies."""

import mpmath
import numpy as np
import pytest

from percept.errors import RefusalError, UsageError
from percept.inference.classical.fiducial import central_range_confidence
from percept.inference.classical.moments import Moments
from tests import LONG

LEVEL = 0.99


def by_quadrature(value, mean, sd, n, level):
    """Integrate over s/sigma: given it, delta is normal about its estimate times s/sigma."""
    nu = mpmath.mpf(n - 1)
    half_width = mpmath.sqrt(2) * mpmath.erfinv(mpmath.mpf(level))
    distance = (mpmath.mpf(value) - mean) / sd
    log_scale = (nu / 2) * mpmath.log(nu / 2) - mpmath.loggamma(nu / 2) + mpmath.log(2)

    def integrand(ratio):
        density = mpmath.exp(log_scale + (nu - 1) * mpmath.log(ratio) - nu * ratio**2 / 2)
        above = mpmath.ncdf(mpmath.sqrt(n) * (half_width - distance * ratio))
        below = mpmath.ncdf(mpmath.sqrt(n) * (-half_width - distance * ratio))
        return density * (above - below)

    return mpmath.quad(
        integrand, [0, 0.001, 0.01, 0.1, 0.3, 0.6, 0.8, 0.9, 1, 1.1, 1.2, 1.5, 2, 3, 6, 12]
    )


@pytest.mark.evidence(reduced=True)
@pytest.mark.parametrize("n", [2, 3, 10, 100, 1000] if LONG else [2, 1000])
@pytest.mark.parametrize(
    "value", [-4.0, 0.5, 1.0, 2.5758, 9.0, 500.0] if LONG else [-4.0, 0.5, 2.5758, 500.0]
)
@pytest.mark.parametrize("level", [0.5, 0.99])
def test_against_quadrature(n, value, level):
    found = central_range_confidence(value, Moments(mean=0.5, sd=0.8, n=n), central=level)
    assert found == pytest.approx(float(by_quadrature(value, 0.5, 0.8, n, level)), abs=1e-10)


def test_broadcasts_and_refuses():
    users = Moments(mean=np.zeros(3), sd=np.ones(3), n=np.array([5, 10, 20]))
    assert np.all(np.diff(central_range_confidence(1.5, users)) > 0.0)
    assert isinstance(central_range_confidence(0.0, Moments(mean=0.0, sd=1.0, n=5)), float)
    with pytest.raises(RefusalError, match="All users set the same value"):
        central_range_confidence(0.0, Moments(mean=0.0, sd=0.0, n=5))
    with pytest.raises(UsageError, match="central must lie strictly between 0 and 1"):
        central_range_confidence(0.0, Moments(mean=0.0, sd=1.0, n=5), central=1.0)
