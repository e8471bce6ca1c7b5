"""Settings shared by all tests."""

import gc
import os

# A worker runs per core: threads of BLAS would only wait for one another. percept's command sets
# the same. NumPy reads it when it is imported.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import pytest
from hypothesis import settings

from tests import LONG
from tests.fits import SHARED

# No test reads or fills the user's cache, nor gets from one what it means to compute.
os.environ["PERCEPT_CACHE"] = "off"

# The same examples on every run, so that a failure repeats; no deadline, since machines are noisy.
settings.register_profile("percept", derandomize=True, deadline=None)
settings.load_profile("percept")


#: What begins a test's id, in groups that share fits and fixtures of seconds: one worker runs all
#: of a group. They come first, since no worker should end alone with one.
TOGETHER = (
    ("tests/study/",),
    ("tests/report/",),
    ("tests/commands/",),
    ("tests/test_readme.py", "tests/test_notebooks.py"),
)


@pytest.fixture(scope="session")
def posteriors():
    """The folder of the shared posteriors, for commands."""
    return str(SHARED.folder)


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config, log):
    """Hand out files, some of them together, in the order of the collection."""
    if config.getvalue("dist") != "loadfile":
        return None
    from xdist.scheduler import LoadFileScheduling

    class Scheduling(LoadFileScheduling):
        def _split_scope(self, nodeid):
            groups = [group[0] for group in TOGETHER if nodeid.startswith(group)]
            return groups[0] if groups else super()._split_scope(nodeid)

    config.option.loadscopereorder = False
    return Scheduling(config, log)


def pytest_configure(config):
    config.addinivalue_line(
        "markers",
        "evidence(reduced=False): takes minutes, run by `make evidence`;"
        " with reduced=True by `make test` too, over fewer cases",
    )


def pytest_collection_finish():
    # What was imported and collected stays: no collection of garbage looks at it again.
    gc.collect()
    gc.freeze()


def pytest_collection_modifyitems(items):
    items.sort(key=lambda item: not item.nodeid.startswith(sum(TOGETHER, ())))
    for item in items:
        marker = item.get_closest_marker("evidence")
        if marker is not None and not LONG and not marker.kwargs.get("reduced", False):
            item.add_marker(pytest.mark.skip(reason="takes minutes: run `make evidence`"))
