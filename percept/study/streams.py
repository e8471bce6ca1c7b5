"""Streams of random numbers, one per purpose, all from the scene's seed and independent of the sampler's."""

from __future__ import annotations

import enum

import numpy as np


@enum.unique
class Stream(enum.IntEnum):
    """What draws are for; two purposes with one number would share their draws."""

    LOCATIONS = 101
    POSTERIOR_CURVES = 102
    CLASSICAL_CURVES = 103
    REALISM = 104
    NEW_ENVIRONMENT = 105
    NEW_BOUNDARIES = 106
    CLASSICAL_BANDS = 107
    POSTERIOR_BANDS = 108
    PRIOR_PULL = 109
    PAIRS = 110
    PREDICTIVE = 113
    CHECKED_STATISTICS = 127
    PRIOR = 131


def generator(seed: int, stream: Stream) -> np.random.Generator:
    """Return a new generator of a stream."""
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(stream,)))
