"""Slow twins of the tolerance factors, in 20 digits and by another order of integration.

`percept` integrates the sample mean out last and sums the lower tail of chi-square. Here the sample
SD is integrated last, against its density, and the upper form is used: with 20 digits nothing is
lost by that. Run as a script to write `tolerance_factors.json` again (a few minutes).
"""

from __future__ import annotations

import itertools
import json
import sys
from pathlib import Path

import mpmath as mp

from percept.inference import tolerance_factor

TABLE = Path(__file__).with_name("tolerance_factors.json")
DIGITS = 20


def factor(n: int, share: float, confidence: float) -> tuple[mp.mpf, float]:
    """Return the factor to 15 digits and more, and the relative error of the package's.

    One Newton step on the 20-digit residual: an error of 1e-8 would be squared, and only the slope
    of the step is the package's own.
    """
    c = tolerance_factor(n, share, confidence)
    delta = 1e-4 * (1.0 - confidence)
    ends = tolerance_factor(n, share, [confidence - delta, confidence + delta])
    with mp.workdps(DIGITS):
        residual = confidence_of(n, share, mp.mpf(c)) - mp.mpf(confidence)
        exact = c - residual * mp.mpf(float(ends[1] - ends[0])) / mp.mpf(2 * delta)
        return exact, float((c - exact) / exact)


def confidence_of(n: int, share: float, c: mp.mpf) -> mp.mpf:
    """Return the probability that mean ± c·SD holds at least `share`."""
    outside = 1 - mp.mpf(share)
    least = mp.sqrt(2) * mp.erfinv(mp.mpf(share)) / c

    def given_root(u: mp.mpf) -> mp.mpf:
        s = least + u * u  # x grows like a root at the least SD that can do
        x = _farthest_mean(c * s, outside)
        return 2 * u * sd_density(n, s) * mp.erf(x * mp.sqrt(mp.mpf(n) / 2))

    pieces = [mp.sqrt(s - least) for s in _pieces(n, least, least)]
    return mp.quad(given_root, pieces, method="gauss-legendre", maxdegree=6)


def sd_density(n: int, s: mp.mpf) -> mp.mpf:
    """Return the density of SD/sigma."""
    half = mp.mpf(n - 1) / 2
    if s == 0:
        return mp.sqrt(2 / mp.pi) if n == 2 else mp.mpf(0)
    return 2 * mp.exp(
        half * mp.log(half) - mp.loggamma(half) + (2 * half - 1) * mp.log(s) - half * s * s
    )


def _pieces(n: int, least: mp.mpf, scale: mp.mpf) -> list[mp.mpf]:
    width = 1 / mp.sqrt(2 * mp.mpf(n - 1))
    marks = [1 + k * width for k in (-12, -6, -3, 0, 3, 6, 12)]
    # large factors decide far below s = 1: resolve that on its own scale too
    near = [scale * 4**k for k in range(1, 20) if scale * 4**k < mp.mpf(1) / 3]
    return sorted({least, *near, *(mark for mark in marks if mark > least)})


def _farthest_mean(r: mp.mpf, outside: mp.mpf) -> mp.mpf:
    """Solve Q(r + x) + Q(r − x) = outside for x ≥ 0; Q(r − x) ≤ outside bounds x from above."""
    lower, upper = mp.mpf(0), r + mp.sqrt(2) * mp.erfinv(2 * outside - 1)
    if upper <= 0:
        return mp.mpf(0)

    def excess(x: mp.mpf) -> mp.mpf:
        return (mp.erfc((r + x) / mp.sqrt(2)) + mp.erfc((r - x) / mp.sqrt(2))) / 2 - outside

    if excess(upper) <= 0 or excess(lower) >= 0:
        return upper if excess(upper) <= 0 else lower
    return mp.findroot(excess, (lower, upper), solver="anderson", verify=False)


def grid() -> list[tuple[int, float, float]]:
    sizes = (2, 3, 5, 10, 30, 100, 1000, 10**4, 10**5, 10**6)
    probabilities = (0.5, 0.9, 0.95, 0.99, 0.9999)
    return list(itertools.product(sizes, probabilities, probabilities))


def main() -> None:
    rows = []
    for n, share, confidence in grid():
        exact, error = factor(n, share, confidence)
        rows.append([n, share, confidence, mp.nstr(exact, 17)])
        sys.stderr.write(f"{rows[-1]} {error:.1e}\n")
    TABLE.write_text(json.dumps(rows).replace("], [", "],\n["), encoding="utf-8")


if __name__ == "__main__":
    main()
