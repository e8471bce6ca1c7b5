"""A run that was stopped goes on to the same digits, wherever it was stopped."""

import numpy as np
import pytest

from percept.cache.entry import decode, encode
from percept.inference.sampling import run as running
from percept.inference.sampling import unfinished
from percept.inference.sampling.estimands import Means
from percept.inference.sampling.run import Settings, sample
from tests.inference.sampling.targets import SkewedHeavy

TARGET = SkewedHeavy(3)
ESTIMANDS = Means(("a", "b"), lambda points: np.tanh(points[:, :2]))
SETTINGS = Settings(tolerance=0.004, seed=3, most_steps=900)


class Memory:
    """Keeps what it is given, and begins with what it is told."""

    def __init__(self, first=None):
        self.first, self.saved = first, []

    def load(self):
        return self.first

    def save(self, one):
        self.saved.append(one)


def same(one, other):
    for name in ("points", "components", "errors", "times"):
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name))
    np.testing.assert_array_equal(one.estimates.value, other.estimates.value)
    assert one.gate == other.gate
    assert (one.steps, one.stride) == (other.steps, other.stride)


@pytest.fixture
def often(monkeypatch):
    """Save after every piece; pieces and memory small, so that a run has many, and several parts."""
    monkeypatch.setattr(unfinished, "_SECONDS", 0.0)
    monkeypatch.setattr(running, "_PIECE", 60)
    monkeypatch.setattr(running, "_KEPT_LIMIT", 1 << 14)


def test_taken_up_anywhere_it_ends_alike(often):
    memory = Memory()
    whole = sample(TARGET, ESTIMANDS, SETTINGS, keeper=memory)
    assert len(memory.saved) >= 4
    assert any(kept.closed for kept in memory.saved)
    assert whole.stride > memory.saved[-1].stride
    for kept in memory.saved[:: max(1, len(memory.saved) // 3)]:
        # As files hold it: arrays in the order of their shape.
        stored = decode(encode(kept))
        same(sample(TARGET, ESTIMANDS, SETTINGS, keeper=Memory(stored)), whole)


def test_an_interrupt_saves_the_last_whole_piece(monkeypatch):
    monkeypatch.setattr(running, "_PIECE", 60)
    memory = Memory()

    def stop(_):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        sample(TARGET, ESTIMANDS, SETTINGS, keeper=memory, progress=stop)
    (kept,) = memory.saved
    assert kept.points.shape[1] * kept.stride >= 144
    again = sample(TARGET, ESTIMANDS, SETTINGS, keeper=Memory(kept))
    same(again, sample(TARGET, ESTIMANDS, SETTINGS))


def test_other_errors_and_quick_runs_save_nothing():
    memory = Memory()
    sample(TARGET, ESTIMANDS, Settings(tolerance=0.1, seed=1), keeper=memory)
    assert memory.saved == []

    def fail(_):
        raise RuntimeError("no")

    with pytest.raises(RuntimeError, match="no"):
        sample(TARGET, ESTIMANDS, SETTINGS, keeper=memory, progress=fail)
    assert memory.saved == []
