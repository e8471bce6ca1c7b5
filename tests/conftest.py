"""Settings shared by all tests."""

import os

from hypothesis import settings

# No test reads or fills the user's cache, nor gets from one what it means to compute.
os.environ["PERCEPT_CACHE"] = "off"

# The same examples on every run, so that a failure repeats; no deadline, since machines are noisy.
settings.register_profile("percept", derandomize=True, deadline=None)
settings.load_profile("percept")
