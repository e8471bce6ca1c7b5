"""Priors of the scales: their laws, their coordinates' names, and which are in force."""

import dataclasses

import numpy as np
import pytest

from percept.errors import UsageError
from percept.inference.model.priors import MEANINGS, Priors
from tests.inference.model.designs import made


def test_names_say_which_coordinate_is_which():
    model = made("plain, trials").model
    base = np.zeros((1, len(model.names)))
    named = model.scales(base)
    for i, label in enumerate(model.names):
        moved = base.copy()
        moved[:, i] = 0.5
        changed = {
            name
            for name, (_, values) in model.scales(moved).items()
            if not np.array_equal(values, named[name][1])
        }
        key = label.split("[")[0].replace("log_s", "s")
        assert key in changed
        # Spreads move with omega, and their trend with both; decades off their centre tie s to
        # kappa.
        suffix = "_e" if key.endswith("_e") else ""
        trend = {"s" + suffix, "kappa" + suffix}
        follows = {"omega": {"sigma" + suffix} | trend, "sigma": trend, "s": trend, "kappa": trend}
        follows = follows.get(key.removesuffix("_e"), set())
        assert changed <= {key} | follows


def test_options_remove_their_coordinates():
    def heads(**options):
        model = made("plain", options=options).model
        return {name.split("[")[0] for name in model.names}

    everything = {"sigma", "log_s", "kappa", "omega", "rho_w", "sigma_u", "rho_u", "tau"}
    assert heads() == everything
    assert heads(weber=True) == everything - {"kappa"}
    assert heads(subject_effect=False) == everything - {"sigma_u", "rho_u"}
    assert heads(common_spread=True) == everything - {"sigma", "omega"}
    assert {name.split("[")[0] for name in made("one cell").model.names} == {"sigma", "rho_w"}


@pytest.mark.parametrize(
    "name",
    ["plain", "plain, trials", "one quantity", "one cell", "weber", "common spread",
     "no subject effect", "two by two, spread", "covariates of trials", "subjects' trial SDs"],
)  # fmt: skip
def test_priors_in_force_are_those_whose_change_moves_the_density(name):
    """For every prior, against the density itself."""
    model = made(name).model
    points = np.random.default_rng(3).normal(size=(3, len(model.names)))
    for field in dataclasses.fields(Priors):
        value = getattr(Priors(), field.name)
        changed = made(name, priors=Priors(**{field.name: 1.5 * value})).model
        moved = not np.array_equal(changed(points), model(points))
        assert moved == (field.name in model.priors_in_force), field
        assert not moved or model.priors_in_force[field.name] == value


@pytest.mark.parametrize("field", [f.name for f in dataclasses.fields(Priors)])
def test_priors_refuse_what_is_no_scale(field):
    assert field in MEANINGS
    with pytest.raises(UsageError, match=rf"{field} = nan: a prior must be finite"):
        Priors(**{field: np.nan})
    if not field.endswith("_mean"):
        with pytest.raises(UsageError, match=rf"{field} = 0.0: a prior scale must be positive"):
            Priors(**{field: 0.0})
