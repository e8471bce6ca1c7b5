"""Progress of a command on a terminal."""

from __future__ import annotations

import sys
import threading
from types import TracebackType
from typing import TYPE_CHECKING, Any, Self

if TYPE_CHECKING:
    from percept.inference.sampling.run import Progress

_WAIT = 2.0  # seconds before anything is shown
_WIDE = 80  # columns that leave room for a bar beside the words


class Working:
    """Shows that a command is at work, after two seconds, and how far its sampler is."""

    def __init__(self, what: str, *, shown: bool) -> None:
        self._shown = shown and sys.stderr.isatty()
        self._said: dict[str, Any] = {"description": what}
        self._bar: Any = None
        self._lock = threading.Lock()
        # A thread's: what takes long may be one call that tells nothing.
        self._timer = threading.Timer(_WAIT, self._open)
        self._timer.daemon = True

    def __enter__(self) -> Self:
        if self._shown:
            self._timer.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        with self._lock:
            self._shown = False
            self._timer.cancel()
            if self._bar is not None:
                self._bar.stop()

    def __call__(self, state: Progress) -> None:
        """Show the sampler's steps, its worst error, of a half-width, what is asked, and the time left."""
        total = max(state.expected_steps, state.steps)
        error = f"error {state.worst_error:.2%}, asked {state.tolerance:.2%}"
        with self._lock:
            self._said = {
                "description": f"{state.steps}/{total} steps, {error}",
                "completed": state.steps,
                "total": total,
            }
            if self._bar is not None:
                self._bar.update(self._bar.task_ids[0], **self._said)

    def _open(self) -> None:
        from rich.console import Console
        from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

        with self._lock:
            if not self._shown:
                return
            console = Console(stderr=True)
            self._bar = Progress(
                TextColumn("{task.description}"),
                *([BarColumn(bar_width=16)] if console.width >= _WIDE else []),
                TimeRemainingColumn(),
                TimeElapsedColumn(),
                console=console,
                # What the command prints belongs on standard output, whatever is shown beside it.
                redirect_stdout=False,
            )
            self._bar.add_task(**({"total": None} | self._said))
            self._bar.start()
