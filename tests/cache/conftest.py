import numpy as np
import pytest

from percept.inference.sampling.gate import Gate, Measured, Run, Settings


@pytest.fixture
def run():
    """A run with every kind of value a record can hold, among them infinity and the smallest
    double."""
    rng = np.random.default_rng(5)
    points = rng.standard_normal((4, 6, 8, 3))
    components = np.concatenate([points, np.full((4, 6, 8, 1), 5e-324)], axis=3)
    return Run(
        points=points,
        components=components,
        estimates=Measured(
            ("lower", "größer"),
            value=np.array([0.1, -0.0]),
            scale=np.array([1.0, np.inf]),
            errors=np.array([1e-3, 2e-3]),
            times=np.array([12.5, 1.0 / 3.0]),
            rhats=np.array([1.0, np.nan]),
        ),
        gate=Gate(
            False,
            ("late.", "stuck."),
            None,
            12.5,
            "größer",
            9.9,
            61.4,
            0.3,
            0.1,
            float("inf"),
            "lower",
            False,
            "inf.",
        ),
        steps=280,
        stride=6,
        settings=Settings(tolerance=0.05, seed=7),
    )
