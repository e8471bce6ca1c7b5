"""What commands share: arguments, the study that these describe, progress on a terminal."""

from __future__ import annotations

import argparse
import math
import sys
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, Self

from percept.commands import QUIET, Argument, argument, flag, number
from percept.errors import RefusalError, UsageError, printable

if TYPE_CHECKING:
    import rich.progress

    from percept.inference.sampling.gate import Progress
    from percept.scene import Scene
    from percept.study import Study
    from percept.workers import Mapper


# Keys of [inference] that have a flag.
_SETTINGS = ("seed", "tolerance", "level", "family", "method")
# Notices printed: what a terminal shows at once. percept validate lists all.
_NOTICES = 10
# s after which a stage is said: a shorter one is over before its line is read.
_SLOW_STAGE = 2.0
# s of a run from which on a command says how long it takes: one may want a larger tolerance.
_LONG = 60.0

SESSIONS = argument(
    "sessions", "PATH", "session files or folders, or a published summary", nargs="+"
)
#: The scene, and the settings of `[inference]` that have a flag.
SETTINGS = (
    argument("--scene", "FILE", "TOML file that says what to analyse"),
    number("--seed", "N", "seed of the sampler (1)"),
    number("--tolerance", "X", "Monte Carlo error over half-width (0.01)"),
    number("--level", "X", "confidence or credibility (0.99)"),
    argument(
        "--family",
        None,
        "scale of the hierarchical model (lognormal)",
        choices=("lognormal", "normal"),
    ),
    argument(
        "--method", None, "which method to run (both)", choices=("both", "classical", "bayesian")
    ),
    QUIET,
)
#: What describes a study.
STUDY = (
    SESSIONS,
    *SETTINGS,
    flag("--no-cache", "sample again, and keep no posterior (see percept doctor --cache)"),
)
#: As `open_mapper` takes them.
WORKERS = (
    number("--workers", "N", "processes on this machine (all cores)"),
    argument("--scheduler", "ADDRESS", "a running dask scheduler, in their place"),
)


def checks_argument(*, usual: bool) -> Argument:
    """Describe `--checks` and `--no-checks`, which override the scene's `[checks]`."""
    meaning = (
        f"check the model: normality, subjects left out, predictions ({'yes' if usual else 'no'})"
    )
    return argument(
        "--checks", None, meaning, action=argparse.BooleanOptionalAction, default=usual or None
    )


def settings(arguments: argparse.Namespace) -> dict[str, str | float | None]:
    """Return the keys of `[inference]` that have a flag, None where it is not given."""
    return {name: getattr(arguments, name) for name in _SETTINGS}


def read_scene(arguments: argparse.Namespace) -> Scene:
    """Return the scene that is named, or the default one."""
    from percept.scene import Scene

    return Scene.load(arguments.scene) if arguments.scene else Scene()


def open_study(
    arguments: argparse.Namespace, progress: Working | None = None, *, by: str | None = None
) -> Study:
    """Read the sessions and the scene, put them together, and say what the reader noticed.

    The model has the column `by`, in the place of `[study] factor` unless the scene names it.
    """
    from percept.sessions import read_sessions
    from percept.study import Study

    scene = read_scene(arguments).with_inference(**settings(arguments))
    if by is not None and not any(by in term for term in scene.terms):
        scene = scene.with_tables(study=scene.study.model_dump(exclude_none=True) | {"factor": by})
    if (checks := getattr(arguments, "checks", None)) is not None:
        scene = scene.with_tables(checks={} if checks else None)
    sessions = read_sessions(*arguments.sessions, scene=scene)
    if not arguments.quiet:
        notices = (*sessions.warnings, *sessions.notices)
        for text in notices[:_NOTICES]:
            notice(str(text))
        if len(notices) > _NOTICES:
            print(
                f"and {len(notices) - _NOTICES} more notices: see percept validate", file=sys.stderr
            )
    store = None
    if not arguments.no_cache and scene.inference.method != "classical":
        from percept.cache import PosteriorCache, cache_folder

        folder = cache_folder()
        store = None if folder is None else PosteriorCache(folder)
    study = Study(sessions, scene, progress=progress, store=store)
    if scene.device is not None and scene.device.response:
        _ = study.device  # a table that cannot be read is refused before anything is sampled
    return study


def show(text: str) -> None:
    """Print results, escaping what names in them would do to a terminal."""
    print("\n".join(printable(line) for line in text.split("\n")))


def print_table(
    rows: Any, columns: Sequence[str] | None = None, *, head: str = "", digits: int = 4
) -> None:
    """Print a table or records: of the columns that are wanted, those that are not empty."""
    import pandas as pd

    table = pd.DataFrame(rows)
    table = table[[*(columns or table.columns)]].dropna(axis=1, how="all")
    number = f"{{:.{digits}g}}".format
    text = table.to_string(index=False, float_format=number, na_rep="–")
    show(f"\n{head}\n{text}" if head else text)


def notice(text: str) -> None:
    """Print a notice on standard error."""
    print(f"notice: {printable(text)}", file=sys.stderr)


@contextmanager
def open_mapper(arguments: argparse.Namespace) -> Iterator[Mapper]:
    """Open the workers that `WORKERS` ask for, and end those that were started."""
    if arguments.scheduler is None:
        from percept.workers import processes

        yield processes(arguments.workers)
        return
    if arguments.workers is not None:
        raise UsageError(
            "a scheduler has workers of its own.", hint="Give --workers or --scheduler."
        )
    # dask takes a second to import, and is not always installed.
    from percept.workers import connected, on_cluster

    with connected(arguments.scheduler) as client:
        yield on_cluster(client)


def verdict(study: Study) -> int:
    """Tell what the gate withholds, or the error it lets pass; return the exit code."""
    fit = study.fit
    if fit is None and study.scene.inference.method != "classical":
        why = "; ".join(part.why for part in study.skipped_of("prepared"))
        lacking = f"there are no Bayesian intervals: {why}"
    elif fit is not None and not fit.run.gate.passed:
        lacking = f"Bayesian intervals are withheld: {fit.withheld}"
    else:
        tell_error(study)
        return 0
    print(f"percept: {printable(lacking)}", file=sys.stderr)
    return RefusalError.exit_code


def tell_error(*studies: Study) -> None:
    """Say on standard error that Bayesian numbers are less accurate than asked."""
    for study in studies:
        gate = study.fit.run.gate if study.fit is not None else None
        if gate is not None and gate.passed and not gate.tolerance_met:
            print(f"percept: {printable(gate.error_reached)}", file=sys.stderr)


def print_json(value: Any) -> None:
    """Print a result as JSON."""
    from percept.results import dumps, plain

    print(dumps(plain(value)), end="")


class Working:
    """Shows how far a command is and the time left; tells how long a long run takes."""

    def __init__(self, what: str, *, shown: bool) -> None:
        self._has_told_time = not shown
        self._shown = shown
        self._bar = _bar(what) if shown and sys.stderr.isatty() else None
        self._waiting: threading.Timer | None = None

    def __enter__(self) -> Self:
        if self._bar is not None:
            self._bar.start()
        return self

    def __exit__(self, *error: object) -> None:
        self.stop()

    def stop(self) -> None:
        """Clear the line, before results are printed."""
        if self._waiting is not None:
            self._waiting.cancel()
        if self._bar is not None:
            self._bar.stop()

    def stage(self, name: str) -> None:
        """Show what is worked on; where there is no terminal, say it once it takes a while."""
        if self._waiting is not None:
            self._waiting.cancel()
        if self._bar is not None:
            self._bar.reset(self._bar.task_ids[0], description=name, total=None)
        elif self._shown:
            where = {"file": sys.stderr, "flush": True}
            self._waiting = threading.Timer(_SLOW_STAGE, print, [f"percept: {name} …"], where)
            self._waiting.daemon = True
            self._waiting.start()

    def show(self, words: str, done: int, total: int) -> None:
        """Show how much of a whole is done, with what else there is to say."""
        if self._bar is not None:
            self._bar.update(self._bar.task_ids[0], description=words, completed=done, total=total)

    def __call__(self, state: Progress) -> None:
        """Show the sampler's steps, and its worst error beside the tolerance, of a half-width."""
        total = max(state.expected_steps, state.steps)
        words = f"sampling: {state.steps}/{total} steps"
        if math.isfinite(state.worst_error):
            words += f", error {state.worst_error:.2%}, asked {state.tolerance:.2%}"
        self.show(words, state.steps, total)
        if self._bar is not None:
            self._bar.refresh()  # a short run would be over before the next turn
        if not self._has_told_time and state.seconds_left > _LONG:
            self._has_told_time = True
            quicker = f" Quicker: {state.quicker}." if state.quicker else ""
            minutes = f"{state.seconds_left / 60.0:.0f} min"
            print(f"percept: sampling takes about {minutes}.{quicker}", file=sys.stderr, flush=True)


def _bar(what: str) -> rich.progress.Progress:
    from rich.console import Console
    from rich.progress import Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

    # Standard output is for the results alone.
    bar = Progress(
        TextColumn("{task.description}", markup=False),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
        TextColumn("left"),
        console=Console(stderr=True),
        transient=True,
        redirect_stdout=False,
        refresh_per_second=4,
    )
    bar.add_task(what, total=None)
    return bar
