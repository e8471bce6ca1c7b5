"""How the C library keeps memory between array operations."""

from __future__ import annotations

import ctypes
import functools
import sys

__all__ = ["keep_freed_memory"]

# From glibc's malloc.h; the second is the largest it takes.
_M_TRIM_THRESHOLD, _M_MMAP_THRESHOLD = -1, -3
_LEFT_AT_THE_TOP, _LARGEST_ON_THE_HEAP = 1 << 26, 1 << 25


@functools.cache
def keep_freed_memory() -> None:
    """Let freed memory of arrays stay with the process, up to 64 MB.

    glibc gives arrays of some 100 kB back to the system as soon as they are freed, at first, and always where
    the environment sets a threshold, as that of dask's workers does. Taking them again, page by page, takes
    longer than the arithmetic done in them. Elsewhere than with glibc nothing is done.
    """
    if sys.platform != "linux":
        return
    library = ctypes.CDLL(None)
    if hasattr(library, "gnu_get_libc_version"):
        library.mallopt(_M_TRIM_THRESHOLD, _LEFT_AT_THE_TOP)
        library.mallopt(_M_MMAP_THRESHOLD, _LARGEST_ON_THE_HEAP)
