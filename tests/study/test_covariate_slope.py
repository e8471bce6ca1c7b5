"""The slope on a covariate of subjects is that of least squares."""

import numpy as np
import pandas as pd
import pytest
from scipy import stats

from percept import Scene, Study


def test_a_covariate_of_one_environment_has_the_slope_of_least_squares():
    rng = np.random.default_rng(5)
    age = np.repeat(rng.uniform(20.0, 60.0, 30), 2)
    own = np.repeat(0.05 * rng.standard_normal(30), 2)
    response = 0.004 * age + own + 0.02 * rng.standard_normal(60)
    table = pd.DataFrame({"age": age, "k_adj": 500.0 * np.exp(response)}).assign(
        subject=[f"S{i // 2}" for i in range(60)],
        trial=[1, 2] * 30,
        environment="only",
        k_ref=500.0,
    )
    scene = Scene(model={"bias": "age"}, inference={"method": "bayesian", "level": 0.95})
    (slope,) = Study(table, scene).contrast_rows
    means = table.assign(response=response).groupby("subject")[["age", "response"]].mean()
    expected = stats.linregress(means["age"], means["response"])
    # Centred on zero, the slope's prior is wide: 0.5 for an SD of age, of 0.05 here.
    assert np.log(slope.estimate) == pytest.approx(expected.slope, abs=0.05 * expected.stderr)
    half_width = 0.5 * np.log(slope.upper / slope.lower)
    assert half_width == pytest.approx(stats.t.ppf(0.975, 28) * expected.stderr, rel=0.1)
