"""Posteriors that the tests of a run share: what one worker has sampled, all others find.

What is found is equal in every digit to what is sampled (`tests/cache`). Tests of the sampler
itself, and of one seed against another, sample anew.
"""

from __future__ import annotations

import atexit
import os
import shutil
import tempfile
from pathlib import Path

from percept.cache import PosteriorCache

__all__ = ["SHARED"]

_NAME = "PERCEPT_SHARED_FITS"
# Workers start with the environment of the process that collects, which imports this first.
if _NAME not in os.environ:
    os.environ[_NAME] = tempfile.mkdtemp(prefix="percept-fits-")
    atexit.register(shutil.rmtree, os.environ[_NAME], ignore_errors=True)

#: Give it to a study as its `store`.
SHARED = PosteriorCache(Path(os.environ[_NAME]))
