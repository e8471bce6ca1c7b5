"""Bands that are drawn again from a posterior."""

from __future__ import annotations

import types

import numpy as np
from scipy import stats

from percept import Scene
from percept.inference.hierarchy.density import ConditionalMoments
from percept.study.band import posterior_replicates
from percept.study.responses import ResponseScale


def test_bands_of_the_next_user_lie_about_the_drawn_means() -> None:
    """A spring with next to no damper: the band at omega is that of k/omega, by hand."""
    drawn = np.array([[0.5, -9.0], [-0.5, -9.0]])
    laws = ConditionalMoments(np.array([[0.0, -9.0]] * 2), np.ones((2, 2)), np.full((2, 2), 0.1))
    model = types.SimpleNamespace(
        cells=(("k", "E"), ("b", "E")), laws=lambda points: laws, draw=lambda points, rng: (drawn, drawn)
    )
    fit = types.SimpleNamespace(
        model=model,
        scale=ResponseScale.of(np.array([[100.0], [1e-9]]), "lognormal"),
        points=np.zeros((2, 1)),
        column={("k", "E"): 0, ("b", "E"): 1},
    )
    scene = Scene.from_tables({"inference": {"kinds": ["mean", "user"], "level": 0.9}})
    found = posterior_replicates(fit, scene.inference, ("E",), 10.0)
    half = stats.norm.isf(0.05)
    for kind, centre, reach in (("mean", np.zeros(2), half), ("user", drawn[:, 0], 0.1 * half)):
        wanted = 10.0 * (np.exp(centre + reach) - np.exp(centre - reach))
        np.testing.assert_allclose(found["bayesian", kind, "lognormal"].bands[:, 0], wanted, rtol=1e-6)
