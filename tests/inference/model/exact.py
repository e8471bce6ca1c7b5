"""The model once more in arithmetic of 60 digits: matrices of mpmath numbers, nothing shared
with percept."""

from __future__ import annotations

import mpmath
import numpy as np
from mpmath import mp

DIGITS = 60


def matrix(rows):
    return mpmath.matrix([[mp.mpf(v) for v in row] for row in rows])


def pair(v, g, w):
    """L diag(v, w) L' of doubles, L = [[1, 0], [g, 1]]."""
    v, g, w = (mp.mpf(float(a)) for a in (v, g, w))
    return matrix([[v, g * v], [g * v, w + g * g * v]])


def covariance(sd, sign, rest):
    """Covariance of SDs and a correlation sign (1 - rest), given by doubles."""
    sd = [mp.mpf(float(s)) for s in sd]
    if len(sd) == 1:
        return matrix([[sd[0] ** 2]])
    rho = mp.mpf(float(sign)) * (1 - mp.mpf(float(rest)))
    return matrix([[sd[0] ** 2, rho * sd[0] * sd[1]], [rho * sd[0] * sd[1], sd[1] ** 2]])


def log_normal_density(y, total):
    """log N(y; 0, total) by a Cholesky factorisation."""
    lower = mpmath.cholesky(total)
    white = _forward(lower, y)
    log_det = 2 * mp.fsum(mp.log(lower[i, i]) for i in range(lower.rows))
    return -(mp.fsum(v * v for v in white) + log_det + lower.rows * mp.log(2 * mp.pi)) / 2


def _forward(lower, y):
    white = []
    for i in range(lower.rows):
        known = mp.fsum(lower[i, k] * white[k] for k in range(i))
        white.append((y[i] - known) / lower[i, i])
    return white


def log_likelihood(
    response, subject, environment, x, *, between, shared, trial, tau, alpha_sd=1.0, gamma_sd=0.25
):
    """Log density of stacked trials; `between` and `trial` hold one matrix per environment."""
    size = len(x)
    count = len(subject)
    total = mpmath.matrix(count * size, count * size)
    exact_x = [[mp.mpf(float(v)) for v in row] for row in x]
    for m in range(count):
        for n in range(m + 1):
            i, j, k, h = subject[m], environment[m], subject[n], environment[n]
            for p in range(size):
                for q in range(size):
                    value = mp.zero
                    if p == q:
                        value += mp.mpf(alpha_sd) ** 2
                        if tau is not None:
                            value += mp.mpf(gamma_sd) ** 2 * exact_x[p][j] * exact_x[p][h]
                            if j == h:
                                value += mp.mpf(float(tau[p])) ** 2
                    if i == k and shared is not None:
                        value += shared[p, q]
                    if i == k and j == h:
                        value += between[j][p, q]
                    if m == n and trial is not None:
                        value += trial[j][p, q]
                    total[m * size + p, n * size + q] = value
                    total[n * size + q, m * size + p] = value
    y = [mp.mpf(float(v)) for v in np.asarray(response).ravel()]
    return log_normal_density(y, total)
