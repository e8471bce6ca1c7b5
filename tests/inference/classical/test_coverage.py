"""How often simulated studies' intervals hold what their sentences say."""

from itertools import product

import numpy as np
import pytest
from scipy import special

from percept.inference import Moments, prediction_interval, t_interval, tolerance_interval
from tests import LONG

STUDIES = 4_000
LEVEL, CONFIDENCE = 0.99, 0.95
EVERY = enumerate(product(("normal", "lognormal"), (3, 5, 10, 30), (0.05, 0.2, 0.5)))
#: With their numbers, which seed them.
DESIGNS = [
    (number, *design)
    for number, design in EVERY
    if LONG or (design[1] in (3, 10) and design[2] != 0.2)
]


@pytest.mark.evidence(reduced=True)
@pytest.mark.parametrize(("design", "family", "n", "cv"), DESIGNS)
def test_each_kind_covers_what_it_says_and_the_misreading_does_not(design, family, n, cv):
    random = np.random.default_rng([1, design])
    log = family == "lognormal"
    centre, sigma = (0.0, np.sqrt(np.log1p(cv**2))) if log else (1.0, cv)
    drawn = random.normal(centre, sigma, (STUDIES, n + 1))
    values = np.exp(drawn) if log else drawn
    users, newcomer = Moments.from_values(values[:, :n], log=log), values[:, n]
    mean = t_interval(users, level=LEVEL, family=family)
    user = prediction_interval(users, level=LEVEL, family=family)
    share = tolerance_interval(users, level=LEVEL, confidence=CONFIDENCE, family=family)
    lower, upper = (np.log(share.lower), np.log(share.upper)) if log else (share.lower, share.upper)
    content = special.ndtr((upper - centre) / sigma) - special.ndtr((lower - centre) / sigma)
    misread = float(np.max(mean.expected_share))
    for theory, held in (
        (LEVEL, (mean.lower <= 1.0) & (mean.upper >= 1.0)),
        (LEVEL, (user.lower <= newcomer) & (newcomer <= user.upper)),
        (CONFIDENCE, content >= LEVEL),
        # How many users the interval of the mean holds.
        (misread, (mean.lower <= newcomer) & (newcomer <= mean.upper)),
    ):
        assert abs(np.mean(held) - theory) <= 4.5 * np.sqrt(theory * (1.0 - theory) / STUDIES)
    if n >= 5:
        assert misread < LEVEL - 0.1
    if n == 10:
        assert misread == pytest.approx(0.6472, abs=5e-5)
