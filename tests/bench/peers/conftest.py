import numpy as np
import pytest

from percept.bench.peers.model import PlainDensity, Responses, shapes
from percept.reproduce.published import dataset


@pytest.fixture(scope="session")
def sessions():
    return str(dataset("hbfd_sessions.csv"))


@pytest.fixture(scope="session")
def study(sessions):
    return Responses.of_sessions(sessions)


@pytest.fixture(scope="session")
def unknowns(study):
    """Ten random sets of unknowns, draws last."""
    density = PlainDensity(study)
    points = 0.6 * np.random.default_rng(7).standard_normal((10, density.dimension))
    values = density.unknowns(points)
    assert {name: value.shape[:-1] for name, value in values.items()} == shapes(study)
    return values
