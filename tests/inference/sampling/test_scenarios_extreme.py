"""Studies whose scatter no single cell's SD tells: effects of subjects, and variances up to
1e12."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

from tests import LONG
from tests.inference.sampling.test_scenarios import (
    KINDS,
    answered,
    half_widths,
    responses,
    study_of,
    table_of,
)


def test_a_subject_wild_everywhere_is_an_effect_of_the_subject():
    """Adjusting 200 times too high in every environment: sigma_u takes it up, not the sigmas."""
    response = responses(10, 5, seed=9)
    wild = response.copy()
    wild[3] += np.log(200.0)
    fit = answered(study_of(table_of(wild)))
    scales = fit.model.scales(fit.run.points[:, -1].reshape(-1, fit.run.points.shape[-1]))
    within = np.log(scales["sigma"][1]).mean(axis=0)
    residual = wild - wild.mean(axis=0) - wild.mean(axis=1, keepdims=True) + wild.mean(axis=(0, 1))
    found = np.log(np.sqrt((residual**2).sum(axis=0).T / (9 * 4 / 5)))
    # 7.2 degrees of freedom a cell: a standard error of 0.26.
    assert np.all(np.abs(within - found) < 4 * 0.26)
    assert scales["sigma_u"][1].mean() > 5 * scales["sigma"][1].mean()


@pytest.mark.evidence(reduced=True)
@pytest.mark.parametrize("unit", [1e-3, 1e-6] if LONG else [1e-6])
def test_variances_of_a_million_million(unit):
    """Responses in units a million times too small: the means are pinned by the prior, the
    spread is not."""
    values = responses(10, 3, seed=10, sd=1.0, shared=0.0)
    subject, environment = (axis.ravel() for axis in np.indices(values.shape[:2]))
    table = pd.DataFrame(
        {
            "subject": [f"S{i}" for i in subject],
            "environment": [f"VE{j}" for j in environment],
            "k_ref": 0.0,
            "b_ref": 0.0,
            "k_adj": values[..., 0].ravel(),
            "b_adj": values[..., 1].ravel(),
        }
    )
    study = study_of(table, family="normal", model={"scale": {"k": unit, "b": unit}})
    fit = answered(study)
    spread = half_widths(fit)[KINDS.index("user")] * unit
    around_zero = np.sqrt((values**2).mean(axis=0)).T.ravel()
    assert np.all(np.abs(np.log(spread / (2.576 * around_zero))) < 1.0)
