"""The peers' models are percept's: log densities differ by one constant at random points."""

import numpy as np
import pytest

from percept.bench.peers.engines import ENGINES, engine, numpyro_model, pymc_model
from percept.bench.peers.model import log_joint
from percept.errors import UsageError

#: What PyMC and NumPyro declare, and the Jacobian of each against the unknown it stands for.
NORMAL = ("alpha", "gamma", "log_s", "kappa")
HALF_NORMAL = ("tau", "sigma_u", "omega")


def declared(study, values, draw, form):
    """Values of the declared variables at a set of unknowns, and the log Jacobian d(unknowns)/d(declared)."""
    one = {name: value[..., draw] for name, value in values.items()}
    found = {name: one[name] for name in (*NORMAL, *HALF_NORMAL)}
    found |= {f"half_{name}": 0.5 * (1.0 + one[name]) for name in ("rho_u", "rho_w")}
    root = np.sqrt(1.0 - one["rho_u"] ** 2)
    z_k = one["u"][0] / one["sigma_u"][0]
    z_b = (one["u"][1] / one["sigma_u"][1] - one["rho_u"] * z_k) / root
    found["z_u"] = np.stack([z_k, z_b])
    jacobian = study.subjects * np.log(one["sigma_u"][0] * one["sigma_u"][1] * root)
    if form == "centred":
        found |= {name: one[name] for name in ("delta", "log_sigma")}
    else:
        trend = one["log_s"][:, None] + one["kappa"][:, None] * study.decades
        found["z_delta"] = one["delta"] / one["tau"][:, None]
        found["z_sigma"] = (one["log_sigma"] - trend) / one["omega"][:, None]
        jacobian += study.environments * np.log(one["tau"] * one["omega"]).sum()
    return found, jacobian


def assert_one_constant(study, unknowns, form, log_density):
    """`log_density` of the declared values equals the joint density up to a constant."""
    ours = log_joint(study, unknowns)
    differences = []
    for draw, value in enumerate(ours):
        found, jacobian = declared(study, unknowns, draw, form)
        differences.append(log_density(found) - (value + jacobian))
    # (rho + 1)/2 is declared, not rho: a factor two for each of two correlations.
    assert differences == pytest.approx(np.full(len(ours), 2 * np.log(2.0)), abs=1e-8 * np.abs(ours).max())


@pytest.mark.filterwarnings("ignore")  # of the libraries, about themselves
@pytest.mark.parametrize("form", ["centred", "noncentred"])
def test_pymc_model(study, unknowns, form):
    pytest.importorskip("pymc")
    model = pymc_model(study, form=form)
    density = model.compile_logp(jacobian=False)

    def log_density(values):
        point = {}
        for variable in model.free_RVs:
            inner = model.rvs_to_values[variable]
            value = values[variable.name]
            transform = inner.name.removeprefix(variable.name)
            point[inner.name] = {"_log__": np.log, "_logodds__": lambda v: np.log(v / (1 - v))}.get(
                transform, np.asarray
            )(value)
        return float(density(point))

    assert_one_constant(study, unknowns, form, log_density)


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("form", ["centred", "noncentred"])
def test_numpyro_model(study, unknowns, form):
    numpyro = pytest.importorskip("numpyro")
    numpyro.enable_x64()
    from numpyro.infer.util import log_density as of_model

    model = numpyro_model(study, form=form)
    assert_one_constant(study, unknowns, form, lambda values: float(of_model(model, (), {}, values)[0]))


def test_engines_are_found_by_name():
    assert all(engine(one.name) is one for one in ENGINES)
    with pytest.raises(UsageError, match="no such engine; they are percept, percept-stretch"):
        engine("stan")
