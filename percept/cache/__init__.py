"""Posteriors that were sampled before, found by what they depend on."""

from percept.cache.folder import cache_folder, cache_limit
from percept.cache.key import numbers_version
from percept.cache.store import Entry, PosteriorCache

__all__ = ["Entry", "PosteriorCache", "cache_folder", "cache_limit", "numbers_version"]
