import dataclasses

import numpy as np
import pytest

from percept.cache.entry import DamagedEntry, decode, encode


def assert_same_run(found, run):
    for name in ("points", "components", "errors", "times"):
        np.testing.assert_array_equal(getattr(found, name), getattr(run, name))
    for name in ("value", "scale"):
        stored, wanted = getattr(found.estimates, name), getattr(run.estimates, name)
        assert stored.tobytes() == wanted.tobytes()
    assert found.estimates.names == run.estimates.names
    assert found.gate == run.gate
    assert (found.steps, found.stride, found.settings) == (run.steps, run.stride, run.settings)


def test_a_run_comes_back_in_every_bit(run):
    found = decode(encode(run))
    assert_same_run(found, run)
    np.testing.assert_array_equal(found.thinned(), run.thinned())


def test_every_flipped_bit_and_every_missing_tail_is_noticed(run):
    data = encode(run)
    rng = np.random.default_rng(1)
    places = [*range(60), *rng.integers(60, len(data), 200).tolist(), len(data) - 1]
    for place in places:
        harmed = bytearray(data)
        harmed[place] ^= 1 << int(rng.integers(8))
        with pytest.raises(DamagedEntry, match="its checksum does not fit"):
            decode(bytes(harmed))
    for end in [0, 1, 13, 14, 45, 46, *rng.integers(0, len(data), 50).tolist()]:
        with pytest.raises(DamagedEntry, match="its checksum does not fit"):
            decode(data[:end])


def test_records_of_another_version_are_not_taken(run, monkeypatch):
    import percept.cache.entry as entry

    @dataclasses.dataclass(frozen=True)
    class Settings:
        tolerance: float
        colour: str

    monkeypatch.setitem(entry._RECORDS, "Settings", Settings)
    data = encode(dataclasses.replace(run, settings=Settings(0.1, "red")))
    monkeypatch.undo()
    with pytest.raises(DamagedEntry, match="does not hold a run"):
        decode(data)


def test_what_cannot_be_stored_is_said(run):
    with pytest.raises(TypeError, match="object cannot be stored"):
        encode(dataclasses.replace(run, steps=object()))
