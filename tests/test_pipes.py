"""What goes through a pipe comes out as it was, and can be written to."""

import os
import threading

import numpy as np
import pytest

from percept.pipes import receive, send

ARRAYS = {
    "empty": np.empty((0, 3)),
    "one number": np.array(2.5),
    "other order": np.asfortranarray(np.arange(12.0).reshape(3, 4)),
    "every other": np.arange(20.0)[::2],
    "turned": np.arange(24.0).reshape(2, 3, 4).transpose(2, 0, 1),
    "words": np.array(["a", "größer"]),
    "larger than a pipe": np.random.default_rng(1).normal(size=(300, 1000)),
}


def through(message):
    """Send by one thread and receive by another: a pipe holds little."""
    reading, writing = os.pipe()
    with os.fdopen(reading, "rb") as source, os.fdopen(writing, "wb") as sink:
        sender = threading.Thread(target=send, args=(sink, message))
        sender.start()
        received = receive(source)
        sender.join()
    return received


@pytest.mark.parametrize("name", ARRAYS)
def test_arrays(name):
    wanted = ARRAYS[name]
    found, label = through((wanted, "with it"))
    assert label == "with it"
    assert (found.dtype, found.shape) == (wanted.dtype, wanted.shape)
    np.testing.assert_array_equal(found, wanted)
    assert found.flags.writeable
    assert not np.shares_memory(found, wanted)


def test_one_message_after_another():
    reading, writing = os.pipe()
    with os.fdopen(reading, "rb") as source:
        with os.fdopen(writing, "wb") as sink:
            for message in (None, np.arange(3), {"a": [np.zeros(2), "b"]}):
                send(sink, message)
        assert receive(source) is None
        np.testing.assert_array_equal(receive(source), np.arange(3))
        last = receive(source)
        assert last["a"][1] == "b"
        np.testing.assert_array_equal(last["a"][0], np.zeros(2))
        with pytest.raises(EOFError):
            receive(source)


def test_what_cannot_be_pickled_leaves_nothing_behind():
    reading, writing = os.pipe()
    with os.fdopen(reading, "rb") as source:
        with os.fdopen(writing, "wb") as sink:
            with pytest.raises((AttributeError, TypeError)):
                send(sink, [np.arange(5), lambda: 1])
            send(sink, "next")
        assert receive(source) == "next"
