"""Settings shared by all tests."""

import os

# A worker runs per core: threads of BLAS would only wait for one another. percept's command sets
# the same. NumPy reads it when it is imported.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import pytest
from hypothesis import settings

from tests import LONG

# No test reads or fills the user's cache, nor gets from one what it means to compute.
os.environ["PERCEPT_CACHE"] = "off"

# The same examples on every run, so that a failure repeats; no deadline, since machines are noisy.
settings.register_profile("percept", derandomize=True, deadline=None)
settings.load_profile("percept")


def pytest_configure(config):
    config.addinivalue_line(
        "markers",
        "evidence(reduced=False): takes minutes, run by `make evidence`;"
        " with reduced=True by `make test` too, over fewer cases",
    )


def pytest_collection_modifyitems(items):
    for item in items:
        marker = item.get_closest_marker("evidence")
        if marker is not None and not LONG and not marker.kwargs.get("reduced", False):
            item.add_marker(pytest.mark.skip(reason="takes minutes: run `make evidence`"))
