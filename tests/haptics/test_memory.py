"""Magnitudes are worked out without temporary arrays of the result's size."""

import tracemalloc

import numpy as np

from percept.haptics import Device, perceived_magnitude


def test_scratch_is_small_beside_the_result():
    rng = np.random.default_rng(1)
    stiffness = np.exp(rng.normal(np.log(1000), 0.3, (5, 4000)))
    damping = np.exp(rng.normal(0, 0.3, (5, 4000)))
    omega, out = np.geomspace(0.1, 100, 100)[:, None, None], np.empty((100, 5, 4000))
    tracemalloc.start()
    try:
        perceived_magnitude(omega, Device(1.0, 5.0), stiffness, damping, 1e-3, out=out)
        scratch = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert scratch < out.nbytes / 8
