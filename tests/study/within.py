"""A study of one quantity at three references, with two conditions that the same subjects went through."""

import numpy as np
import pandas as pd

from percept import Scene, Study
from percept.sessions import ReadOptions, Sessions


def frame(subjects=8, trials=2, levels=("left", "right"), seed=3):
    """Trials numbered from 1 at each level; the second level is set higher."""
    rng = np.random.default_rng(seed)
    rows = []
    for s in range(subjects):
        u, v = rng.normal(0.0, [0.2, 0.15])
        for environment, reference in (("VE1", 10.0), ("VE2", 100.0), ("VE3", 1000.0)):
            for c, level in enumerate(levels):
                w = rng.normal(0.0, 0.1)
                rows += [
                    [f"S{s}", environment, level, reference, t, reference * np.exp(y)]
                    for t in range(1, trials + 1)
                    for y in [u + c * (0.2 + v) + w + rng.normal(0.0, 0.05)]
                ]
    return pd.DataFrame(rows, columns=["subject", "environment", "hand", "k_ref", "trial", "k_adj"])


def study(table, family="lognormal", **tables):
    """Classical analysis of a table with the factor "hand"."""
    inference = {"method": "classical", "level": 0.95, "family": family}
    scene = Scene(**{"study": {"factor": "hand"}, "inference": inference, **tables})
    return Study(Sessions.from_frame(table, scene=ReadOptions.from_mapping(dict(scene))), scene)
