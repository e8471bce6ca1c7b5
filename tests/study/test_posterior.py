"""The posterior as ArviZ reads it: groups, names, and its own functions run on the file."""

import re
import warnings
from pathlib import Path

import matplotlib as mpl
import numpy as np
import pytest
import xarray
from scipy import special

from percept.inference.predictive import leave_one_out
from percept.study.posterior import variables_of_posterior
from tests.study.within import frame, study

DOCS = Path(__file__).parents[2] / "docs"
BAYESIAN = {"method": "bayesian", "tolerance": 0.3}


@pytest.fixture(scope="module")
def opened(fitted, tmp_path_factory):
    path = tmp_path_factory.mktemp("posterior") / "posterior.nc"
    path.write_bytes(fitted.posterior_file())
    with xarray.open_datatree(path, engine="h5netcdf") as tree:
        yield tree


@pytest.fixture(scope="module")
def arviz_plots():
    """ArviZ's plots; release 0.8 wants a module that Matplotlib 3.11 no longer imports itself."""
    mpl.use("Agg")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        pytest.importorskip("matplotlib.style.core")
        return pytest.importorskip("arviz_plots")


def test_the_file_holds_what_was_written(opened, fitted):
    assert opened.identical(fitted.posterior)
    trials = fitted.fit.trials
    observed = opened["observed_data/response"]
    means = trials.statistics.cell_means
    one = observed.sel(subject="S04", parameter="b").to_numpy()
    assert one == pytest.approx(means[3, 1], rel=1e-6)
    assert opened["posterior"]["unit"].to_numpy().tolist() == ["N/m", "N·s/m"]


def test_loo_is_percepts_own(opened, fitted):
    import arviz_stats

    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="Estimated shape parameter")
        found = arviz_stats.loo(opened, pointwise=True)
    pointwise = found.elpd_i.to_series()
    assert list(pointwise.index) == list(fitted.sessions.subjects)
    fit = fitted.fit
    loo = leave_one_out(fit.subjects, fit.left_out)
    assert loo.trusted.sum() >= len(pointwise) // 2
    # Both are importance sampling of heavy-tailed weights, over other draws.
    ours = special.logsumexp(np.log(loo.weights) + fit.left_out.log_density, axis=0)
    differences = pointwise.to_numpy() - ours
    np.testing.assert_allclose(differences[loo.trusted], 0.0, atol=0.25)


@pytest.mark.parametrize(
    ("plot", "names"),
    [
        ("plot_forest", ["sigma_u", "subject_effect"]),
        ("plot_pair", ["rho_u", "rho_w"]),
        ("plot_ppc_dist", ["response"]),
    ],
)
def test_arviz_plots_it(opened, arviz_plots, plot, names, tmp_path):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # ArviZ's own, of Matplotlib
        options = {"coords": {"parameter": "k"}} if plot == "plot_forest" else {}
        drawn = getattr(arviz_plots, plot)(opened, var_names=names, **options)
        drawn.savefig(tmp_path / "plot.png")
    assert (tmp_path / "plot.png").stat().st_size > 5_000
    mpl.pyplot.close("all")


def test_subject_effects_lie_where_the_data_are(opened):
    effect = opened["posterior/subject_effect"].mean(("chain", "draw")).to_numpy()
    sigma = opened["posterior/sigma_u"].mean(("chain", "draw")).to_numpy()
    observed = opened["observed_data/response"].to_numpy()
    raw = (observed - observed.mean(axis=0)).mean(axis=2)
    for p in range(2):
        assert np.corrcoef(effect[:, p], raw[:, p])[0, 1] > 0.5
        assert np.abs(effect[:, p]).max() < 3.0 * sigma[p]


def test_a_study_with_a_factor_has_its_terms(tmp_path):
    """A DataTree reads a path at a slash: in a factor's name it is another sign, and the meaning
    keeps the name."""
    table = frame(subjects=4).rename(columns={"hand": "left/right"})
    made = study(table, study={"factor": "left/right"}, inference=BAYESIAN)
    tree = made.posterior
    of_draws = {"posterior", "posterior_predictive", "prior", "sample_stats"}
    assert set(tree.children) == of_draws | {"log_likelihood", "observed_data"}
    found = tree["posterior"].data_vars
    of_factor = "psi:left\N{DIVISION SLASH}right"
    assert {of_factor, of_factor.replace("psi", "eta"), of_factor.replace("psi", "sigma_v")} <= set(
        found
    )
    effect = found["subject_effect"].mean(("chain", "draw"))
    raw = tree["observed_data/response"].mean("environment").to_numpy()
    for p, own in enumerate(raw.T):
        assert np.corrcoef(effect[:, p], own)[0, 1] > 0.9
    path = tmp_path / "posterior.nc"
    path.write_bytes(made.posterior_file())
    with xarray.open_datatree(path, engine="h5netcdf") as read:
        variable = read["posterior"].data_vars[of_factor]
        assert variable.attrs["long_name"] == "differences of levels in log sigma, left/right"


def test_the_page_of_names_has_each_with_its_meaning():
    text = (DOCS / "files.md").read_text(encoding="utf-8").partition("## posterior.nc")[2]
    rows = re.findall(r"^\| `([a-z_]+)` \| ([^|]+) \| ([^|]+) \|$", text, re.MULTILINE)
    known = variables_of_posterior()
    assert {name: {"meaning": meaning, "unit": unit} for name, meaning, unit in rows} == known
