"""A study that the sampler cannot finish in 200 steps: it has not mixed."""

from __future__ import annotations

import numpy as np
import pandas as pd

from tests import DATASETS

#: Settings under which the gate withholds the Bayesian numbers of `unmixed_sessions`.
UNMIXED = {"tolerance": 0.01, "most_steps": 200}


def unmixed_sessions(*environments: str) -> pd.DataFrame:
    """Sessions of two published environments, or of others, damping following stiffness to 0.01 %.

    The posterior is a ridge that is slow to walk along.
    """
    table = pd.read_csv(DATASETS / "hbfd_sessions.csv", dtype={"subject": str}).drop(
        columns="source"
    )
    table = table[table["environment"].isin(environments or ("VE2", "VE4"))]
    scatter = np.exp(0.0001 * np.random.default_rng(1).standard_normal(len(table)))
    return table.assign(b_adj=table["b_ref"] * table["k_adj"] / table["k_ref"] * scatter)
