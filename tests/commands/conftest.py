"""Commands share posteriors: tests/cache holds that they are the same from the cache, digit by
digit."""

import pytest


@pytest.fixture(autouse=True)
def _posteriors_are_kept(posteriors, monkeypatch):
    monkeypatch.setenv("PERCEPT_CACHE", posteriors)
