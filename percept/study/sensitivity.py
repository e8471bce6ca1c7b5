"""Power-scaling sensitivity: how far reported quantities move when priors or data count slightly more."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd

from percept.inference.checks.predictive import GROUPS

#: Sensitivity (a distance of distributions per doubling of the power) from which it is worth a look.
THRESHOLD = 0.05
_QUANTITIES = {"mean": "population_mean", "user": "new_user", "spread": "population_sd"}


def power_scaling(tree: Any) -> pd.DataFrame:
    """Sensitivity of every environment's mean, new user and spread to the priors and to the data.

    Priors (all together, and by what they speak of) and likelihood are raised to powers just off one by
    Pareto-smoothed reweighting (Kallioinen et al. 2024, doi:10.1007/s11222-023-10366-5).
    """
    import xarray

    posterior = tree["posterior"].to_dataset().merge(tree["posterior_predictive"].to_dataset())
    quantities = posterior[list(_QUANTITIES.values())].rename({old: new for new, old in _QUANTITIES.items()})
    groups = {name: tree[name].to_dataset() for name in ("log_prior", "log_likelihood")}
    wanted = xarray.DataTree.from_dict({"posterior": quantities, **groups})
    present = list(groups["log_prior"].data_vars)
    asked: dict[str, dict[str, Any]] = {"prior": {"group": "prior"}, "likelihood": {"group": "likelihood"}}
    for name, variables in GROUPS.items():
        known = [variable for variable in variables if variable in present]
        if known:
            asked[f"prior_{name}"] = {"group": "prior", "group_var_names": known}
    found = {name: _sensitivity(wanted, how) for name, how in asked.items()}
    rows = []
    for environment in posterior["environment"].to_numpy().tolist():
        for parameter in posterior["parameter"].to_numpy().tolist():
            at = {"environment": environment, "parameter": parameter}
            for quantity in _QUANTITIES:
                values = {name: float(table[quantity].sel(at)) for name, table in found.items()}
                rows.append({**at, "quantity": quantity, **values, "diagnosis": _diagnosis(values)})
    return pd.DataFrame(rows)


def _sensitivity(tree: Any, how: dict[str, Any]) -> Any:
    import arviz_stats

    return arviz_stats.psense(tree, **how)  # type: ignore[attr-defined, no-untyped-call]


def _diagnosis(values: dict[str, float]) -> str:
    if not np.isfinite(values["prior"]) or values["prior"] < THRESHOLD:
        return ""
    groups = {name: value for name, value in values.items() if name.startswith("prior_")}
    most = max(groups, key=lambda name: groups[name]).removeprefix("prior_")
    if values["likelihood"] < THRESHOLD:
        return f"the priors (of {most} most) decide, the data hardly count"
    return f"the priors (of {most} most) count beside the data"
