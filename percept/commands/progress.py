"""Progress of the sampler on a terminal."""

from __future__ import annotations

import sys
import time
from types import TracebackType
from typing import TYPE_CHECKING, Any, Self

if TYPE_CHECKING:
    from percept.inference.sampling.run import Progress

__all__ = ["SamplerProgress"]

_WAIT = 2.0  # seconds before anything is shown


class SamplerProgress:
    """Shows steps, the worst error against the tolerance, and the time left, after two seconds.

    Parameters
    ----------
    shown : bool
        Whether to show anything; never without a terminal on standard error.
    """

    def __init__(self, *, shown: bool) -> None:
        self._shown = shown and sys.stderr.isatty()
        self._started = time.monotonic()
        self._bar: Any = None
        self._task: Any = None

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._bar is not None:
            self._bar.stop()

    def __call__(self, state: Progress) -> None:
        """Show the state of the sampler."""
        if not self._shown or time.monotonic() - self._started < _WAIT:
            return
        if self._bar is None:
            self._open()
        self._bar.update(
            self._task,
            completed=state.steps,
            total=max(state.expected_steps, state.steps),
            error=f"worst error {state.worst_error:.2%} of half-width, asked {state.tolerance:.2%}",
        )

    def _open(self) -> None:
        from rich.console import Console
        from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

        self._bar = Progress(
            TextColumn("sampling"),
            BarColumn(),
            TextColumn("{task.completed:.0f}/{task.total:.0f} steps"),
            TextColumn("{task.fields[error]}"),
            TimeRemainingColumn(),
            console=Console(stderr=True),
        )
        self._task = self._bar.add_task("sampling", total=None, error="")
        self._bar.start()
