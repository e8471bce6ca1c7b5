"""Figures drawn beside the analysis: by a second process where there is a second core."""

from __future__ import annotations

import pickle
import signal
import subprocess
import sys
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from types import TracebackType
from typing import IO, Any

from percept.cores import cores
from percept.report.figures.canvas import Drawing
from percept.report.plates import Drawn, drawn

__all__ = ["Artist", "serve"]

# The path first, so that the other process finds the same percept.
_START = """
import pickle, sys
sys.path[:] = pickle.load(sys.stdin.buffer)
from percept.report.artist import serve
serve()
"""


class Artist:
    """Draws figures while their maker goes on; a context that ends with its other process.

    With one core, or where the other process fails or is killed, figures are drawn here when they are asked
    for: the bytes are the same.

    Parameters
    ----------
    formats : sequence of {"svg", "pdf", "png"}
        Of the files.
    processes : int, optional
        1: everything here. By default a second process where there is a second core.

    Attributes
    ----------
    process : Popen or None
        The other process, where there is one.
    answered : int
        Figures it has drawn.
    """

    def __init__(self, formats: Sequence[str], *, processes: int | None = None) -> None:
        self._formats = tuple(formats)
        self._processes = cores() if processes is None else processes
        self.process: subprocess.Popen[bytes] | None = None
        self.answered = 0

    def __enter__(self) -> Artist:
        if self._processes > 1:
            with suppress(OSError):
                self.process = subprocess.Popen(
                    [sys.executable, "-c", _START],
                    stdin=subprocess.PIPE,
                    stdout=subprocess.PIPE,
                    stderr=subprocess.DEVNULL,
                )
        if self.process is not None:
            # One at a time: the thread waits for the answer before it hands over the next drawing.
            self._thread = ThreadPoolExecutor(max_workers=1)
            self._thread.submit(self._tell, sys.path)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self.process is None:
            return
        # Without the other process the thread has nothing to wait for.
        self.process.kill()
        self._thread.shutdown(cancel_futures=True)
        self.process.wait()
        for pipe in (self.process.stdin, self.process.stdout):
            with suppress(OSError):
                _open(pipe).close()

    def draw(self, drawing: Drawing) -> Callable[[], Drawn]:
        """Begin to draw.

        Parameters
        ----------
        drawing : Drawing
            What can be pickled, to be drawn elsewhere.

        Returns
        -------
        callable
            Waits for the figure and returns it; raises what drawing it raises.
        """
        if self.process is None:
            return lambda: drawn(drawing, self._formats)
        answer = self._thread.submit(self._asked, drawing)
        return lambda: answer.result() or drawn(drawing, self._formats)

    def _asked(self, drawing: Drawing) -> Drawn | None:
        """Have it drawn by the other process; None where that fails."""
        assert self.process is not None
        # What cannot be pickled raises any of the last three.
        with suppress(OSError, EOFError, pickle.PickleError, AttributeError, TypeError):
            self._tell((drawing, self._formats))
            answer: Drawn | None = pickle.load(_open(self.process.stdout))  # noqa: S301 - our own process
            self.answered += answer is not None
            return answer
        return None

    def _tell(self, message: Any) -> None:
        assert self.process is not None
        # Whole before it is sent: what cannot be pickled must not leave half a message behind.
        whole = pickle.dumps(message)
        pipe = _open(self.process.stdin)
        pipe.write(whole)
        pipe.flush()


def serve() -> None:
    """Draw what comes in, one after another, until there is nobody left to draw for."""
    # An interrupted maker closes the pipe.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    import matplotlib.backends.backend_svg
    import matplotlib.figure  # noqa: F401

    questions, answers = sys.stdin.buffer, sys.stdout.buffer
    with suppress(EOFError, OSError):
        while True:
            drawing, formats = pickle.load(questions)  # noqa: S301 - our own process
            try:
                answer = drawn(drawing, formats)
            except Exception:  # noqa: BLE001 - it is drawn again where any error can be told
                answer = None
            pickle.dump(answer, answers)
            answers.flush()


def _open(pipe: IO[bytes] | None) -> IO[bytes]:
    assert pipe is not None
    return pipe
