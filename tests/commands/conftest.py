"""Commands share posteriors: tests/cache holds that they are the same from the cache, digit by
digit."""

import pytest


@pytest.fixture(scope="session")
def kept(tmp_path_factory):
    return str(tmp_path_factory.mktemp("posteriors"))


@pytest.fixture(autouse=True)
def _posteriors_are_kept(kept, monkeypatch):
    monkeypatch.setenv("PERCEPT_CACHE", kept)
