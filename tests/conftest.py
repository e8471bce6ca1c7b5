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


#: Their files share fixtures that take seconds, so that one worker runs them all.
TOGETHER = ("tests/report/",)
#: They take long and hold few tests. They begin, so that no worker is left alone with one.
FIRST = ("tests/test_readme.py", "tests/test_notebooks.py")


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config, log):
    """Hand out files, some folders whole, in the order of the collection."""
    if config.getvalue("dist") != "loadfile":
        return None
    from xdist.scheduler import LoadFileScheduling

    class Scheduling(LoadFileScheduling):
        def _split_scope(self, nodeid):
            folders = [folder for folder in TOGETHER if nodeid.startswith(folder)]
            return folders[0] if folders else super()._split_scope(nodeid)

    config.option.loadscopereorder = False
    return Scheduling(config, log)


def pytest_configure(config):
    config.addinivalue_line(
        "markers",
        "evidence(reduced=False): takes minutes, run by `make evidence`;"
        " with reduced=True by `make test` too, over fewer cases",
    )


def pytest_collection_modifyitems(items):
    items.sort(key=lambda item: not item.nodeid.startswith((*TOGETHER, *FIRST)))
    for item in items:
        marker = item.get_closest_marker("evidence")
        if marker is not None and not LONG and not marker.kwargs.get("reduced", False):
            item.add_marker(pytest.mark.skip(reason="takes minutes: run `make evidence`"))
