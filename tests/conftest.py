"""Settings shared by all tests."""

from hypothesis import settings

# The same examples on every run, so that a failure repeats; no deadline, since machines are noisy.
settings.register_profile("percept", derandomize=True, deadline=None)
settings.load_profile("percept")
