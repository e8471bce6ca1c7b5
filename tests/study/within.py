"""Studies of one quantity at three references, with conditions, groups and a covariate."""

import numpy as np
import pandas as pd

from percept import Scene, Study


def frame(subjects=8, trials=2, levels=("left", "right"), seed=3, sds=(0.05, 0.05, 0.05)):
    """Trials numbered from 1 at each level, with its SD; the second level is set higher."""
    rng = np.random.default_rng(seed)
    rows = []
    for s in range(subjects):
        u, v = rng.normal(0.0, [0.2, 0.15])
        for environment, reference in (("VE1", 10.0), ("VE2", 100.0), ("VE3", 1000.0)):
            for c, level in enumerate(levels):
                w = rng.normal(0.0, 0.1)
                for trial in range(1, trials + 1):
                    y = u + c * (0.2 + v) + w + rng.normal(0.0, sds[c])
                    rows.append(
                        [f"S{s}", environment, level, reference, trial, reference * np.exp(y)]
                    )
    return pd.DataFrame(rows, columns=["subject", "environment", "hand", "k_ref", "trial", "k_adj"])


def crossed(subjects=8, seed=4):
    """Two factors within subjects, two groups and a dose, with their effects planted."""
    rng = np.random.default_rng(seed)
    rows = []
    for s in range(subjects):
        u, v = rng.normal(0.0, [0.15, 0.1])
        group = ("novice", "expert")[s % 2]
        for environment, reference in (("VE1", 10.0), ("VE2", 100.0), ("VE3", 1000.0)):
            for h, hand in enumerate(("left", "right")):
                for m, load in enumerate(("low", "high")):
                    w = rng.normal(0.0, 0.1)
                    for trial in (1, 2):
                        dose = rng.normal(2.0, 1.0)
                        y = u + w + 0.1 * dose + 0.5 * (group == "expert") + rng.normal(0.0, 0.05)
                        # Averages over the other factor's levels are 0.3 and -0.2.
                        y += h * (0.1 + v) - 0.4 * m + 0.4 * h * m
                        row = [f"S{s}", environment, hand, load, group, f"{dose:.6f}", reference]
                        rows.append([*row, trial, reference * np.exp(y)])
    names = ["subject", "environment", "hand", "load", "group", "dose", "k_ref", "trial", "k_adj"]
    return pd.DataFrame(rows, columns=names)


def study(table, family="lognormal", *, bias=None, store=None, **tables):
    """Classical analysis of a table with the factor "hand", or another bias."""
    inference = {"method": "classical", "level": 0.95, "family": family}
    inference |= tables.pop("inference", {})
    model = {"bias": bias} | tables.pop("model", {})
    factor = {} if bias else {"factor": "hand"}
    tables = {"study": factor, "inference": inference, "model": model, **tables}
    return Study(table, Scene(**tables), store=store)


def reasons(made):
    """What a study skips, and why."""
    return {part.what: part.why for part in made.skipped_rows}


def only(rows, **where):
    """The one row of a table with these values; None stands for a missing one."""
    for name, value in where.items():
        rows = rows[rows[name].isna() if value is None else rows[name] == value]
    (row,) = rows.to_dict("records")
    return row


def ends_of(row):
    """Lower limit, estimate and upper limit."""
    return [row["lower"], row["estimate"], row["upper"]]
