"""Who works on calls that do not wait for one another: this process alone, or several."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, Protocol, TypeVar

__all__ = ["ALONE", "Share"]

T = TypeVar("T")


class Share(Protocol):
    """Makes calls, and answers them alike whoever makes them."""

    @property
    def parts(self) -> int:
        """Into how many parts work is best divided."""

    def __call__(self, function: Callable[..., T], arguments: Sequence[tuple[Any, ...]]) -> list[T]:
        """Call a function of a module with each of these arguments; answers in their order."""


class _Alone:
    """One process, one call after the other."""

    parts = 1

    def __call__(self, function: Callable[..., T], arguments: Sequence[tuple[Any, ...]]) -> list[T]:
        """Call the function with each of the arguments."""
        return [function(*each) for each in arguments]


ALONE: Share = _Alone()
