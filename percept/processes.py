"""Other processes of this machine that make calls for this one, as long as it lives."""

from __future__ import annotations

import importlib
import os
import pickle
import signal
import subprocess
import sys
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from queue import SimpleQueue
from types import TracebackType
from typing import IO, Any, TypeVar

from percept.cores import cores
from percept.pipes import pack, receive, send, write

__all__ = ["Processes", "serve"]

T = TypeVar("T")

# The path first, so that the other process finds the same percept.
_START = """
import pickle, sys
sys.path[:] = pickle.load(sys.stdin.buffer)
from percept.processes import serve
serve()
"""
#: More would mostly wait: runs have four ensembles, studies a few environments.
_MOST = 4
#: Whether an answer is known, and the answer.
_UNKNOWN: tuple[bool, Any] = (False, None)


class Processes:
    """One process, which asks, and others beside it; a context that ends with the others.

    With one core, or where another process fails or is killed, calls are made here when their answers are
    asked for: the answers are the same.

    Parameters
    ----------
    count : int, optional
        Processes in all, this one among them. By default one per core, four at most.
    preload : sequence of str
        Modules that the others import at once, while they have nothing else to do.

    Attributes
    ----------
    others : list of Popen
        The other processes.
    answered : int
        Calls they have answered.
    """

    def __init__(self, count: int | None = None, *, preload: Sequence[str] = ()) -> None:
        self._count = min(cores(), _MOST) if count is None else count
        self._preload = tuple(preload)
        self.others: list[subprocess.Popen[bytes]] = []
        self.answered = 0

    @property
    def parts(self) -> int:
        """How many processes there are."""
        return 1 + len(self.others)

    def __enter__(self) -> Processes:
        # A BLAS of many threads in each of several processes would have them wait for one another.
        environment = os.environ | {"OPENBLAS_NUM_THREADS": "1"}
        with suppress(OSError):
            for _ in range(self._count - 1):
                self.others.append(
                    subprocess.Popen(
                        [sys.executable, "-c", _START],
                        stdin=subprocess.PIPE,
                        stdout=subprocess.PIPE,
                        stderr=subprocess.DEVNULL,
                        env=environment,
                    )
                )
        self._idle: SimpleQueue[subprocess.Popen[bytes]] = SimpleQueue()
        # A thread for each: it waits for the answer before it hands over the next call.
        self._threads = ThreadPoolExecutor(max_workers=max(1, len(self.others)))
        for other in self.others:
            with suppress(OSError):
                _open(other.stdin).write(pickle.dumps(sys.path))
                send(_open(other.stdin), self._preload)
            self._idle.put(other)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        for other in self.others:
            other.kill()
        # Without the other processes the threads have nothing to wait for.
        self._threads.shutdown(cancel_futures=True)
        for other in self.others:
            other.wait()
            for pipe in (other.stdin, other.stdout):
                with suppress(OSError):
                    _open(pipe).close()
        self.others = []

    def ask(self, function: Callable[..., T], *arguments: Any) -> Callable[[], T]:
        """Have a call begun elsewhere.

        Parameters
        ----------
        function : callable
            Of a module.
        *arguments
            What can be pickled; anything else is worked on here.

        Returns
        -------
        callable
            Waits for the answer and returns it; raises what the call raises.
        """
        if not self.others:
            return lambda: function(*arguments)
        begun = self._threads.submit(self._asked, function, arguments)

        def answer() -> T:
            known, value = begun.result()
            return value if known else function(*arguments)

        return answer

    def __call__(self, function: Callable[..., T], arguments: Sequence[tuple[Any, ...]]) -> list[T]:
        """Call a function with each of several arguments, the last ones elsewhere until all are taken.

        Parameters
        ----------
        function : callable
            Of a module.
        arguments : sequence of tuple
            What can be pickled; anything else is worked on here.

        Returns
        -------
        list
            Answers, in the order of the arguments.
        """
        if not self.others:
            return [function(*each) for each in arguments]
        backwards = [self._threads.submit(self._asked, function, each) for each in arguments[:0:-1]]
        answers: list[T] = []
        for each, begun in zip(arguments, [None, *reversed(backwards)], strict=False):
            # What nobody has begun is worked on here.
            known, value = _UNKNOWN if begun is None or begun.cancel() else begun.result()
            answers.append(value if known else function(*each))
        return answers

    def _asked(self, function: Callable[..., Any], arguments: tuple[Any, ...]) -> tuple[bool, Any]:
        """Have a call made elsewhere; its answer is not known where that fails."""
        try:
            parts = pack((function, arguments))
        except Exception:  # noqa: BLE001 - objects say themselves how they are pickled
            return _UNKNOWN
        other = self._idle.get()
        # An answer that cannot be unpickled raises any of the last three.
        with suppress(OSError, EOFError, pickle.PickleError, AttributeError, TypeError):
            try:
                write(_open(other.stdin), parts)
                known, value = receive(_open(other.stdout))
            finally:
                self._idle.put(other)
            self.answered += known
            return known, value
        return _UNKNOWN


def serve() -> None:
    """Make the calls that come in, one after another, until there is nobody left to make them for."""
    # An interrupted asker closes the pipe.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    questions, answers = sys.stdin.buffer, os.fdopen(os.dup(sys.stdout.fileno()), "wb")
    # What a library prints must not come between answers.
    os.dup2(sys.stderr.fileno(), sys.stdout.fileno())
    with suppress(EOFError, OSError):
        for name in receive(questions):
            importlib.import_module(name)
        while True:
            function, arguments = receive(questions)
            try:
                answer = (True, function(*arguments))
            except Exception:  # noqa: BLE001 - it is made again where any error can be told
                answer = _UNKNOWN
            try:
                parts = pack(answer)
            except Exception:  # noqa: BLE001 - objects say themselves how they are pickled
                parts = pack(_UNKNOWN)
            write(answers, parts)


def _open(pipe: IO[bytes] | None) -> IO[bytes]:
    assert pipe is not None
    return pipe
