"""What every command that analyses sessions shares: its arguments, and the study they describe."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from percept.commands.checks import with_checks

if TYPE_CHECKING:
    from percept.commands.progress import Working
    from percept.scene import Scene
    from percept.sessions.records import Notice
    from percept.study import Study
    from percept.study.bayesian import RunStore

_NOTICES = 10


def add_analysis_arguments(parser: argparse.ArgumentParser) -> None:
    """Add session files, scene and the settings of `[inference]` that have a flag."""
    parser.add_argument(
        "sessions", nargs="+", metavar="PATH", help="session files or folders, or a published summary"
    )
    add_setting_arguments(parser)
    parser.add_argument(
        "--no-cache", action="store_true", help="sample anew, and keep no posterior (see percept cache)"
    )


def add_setting_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the scene and the settings of `[inference]` that have a flag."""
    parser.add_argument("--scene", metavar="FILE", help="TOML file that says what to analyse")
    parser.add_argument("--seed", type=int, metavar="N", help="seed of the sampler")
    parser.add_argument(
        "--tolerance", type=float, metavar="X", help="Monte Carlo error over half-width (0.01)"
    )
    parser.add_argument("--level", type=float, metavar="X", help="confidence or credibility (0.99)")
    parser.add_argument("--family", choices=("lognormal", "normal"), help="scale of the hierarchical model")
    parser.add_argument("--method", choices=("both", "classical", "bayesian"), help="which method to run")
    parser.add_argument("--quiet", action="store_true", help="no progress, no notices")


def add_worker_arguments(parser: argparse.ArgumentParser) -> None:
    """Add `--workers` and `--scheduler`, as `percept.workers.open_mapper` takes them."""
    parser.add_argument("--workers", type=int, metavar="N", help="processes on this machine (all cores)")
    parser.add_argument("--scheduler", metavar="ADDRESS", help="a running dask scheduler, in their place")


def settings(arguments: argparse.Namespace) -> dict[str, Any]:
    """Return the keys of `[inference]` as `add_setting_arguments` parsed them, None where not given."""
    return {name: getattr(arguments, name) for name in ("seed", "tolerance", "level", "family", "method")}


def open_study(
    arguments: argparse.Namespace, progress: Working | None = None, *, groups: Sequence[str] = ()
) -> Study:
    """Read the sessions and the scene, put them together, and say what the reader noticed."""
    from percept.scene import Scene
    from percept.sessions import ReadOptions, read_sessions
    from percept.study import Study

    scene = Scene.load(arguments.scene) if arguments.scene else Scene()
    scene = with_checks(scene.with_inference(**settings(arguments)), arguments)
    options = ReadOptions.from_mapping(dict(scene), file=arguments.scene).with_groups(groups)
    sessions = read_sessions(*arguments.sessions, options=options)
    if not arguments.quiet:
        _tell((*sessions.warnings, *sessions.notices))
    study = Study(sessions, scene, progress=progress, store=_store(arguments, scene))
    if scene.device is not None and scene.device.response:
        _ = study.device
    return study


def _tell(notices: Sequence[Notice]) -> None:
    """Print notices on standard error, of many the first."""
    from percept.errors import printable

    for notice in notices[:_NOTICES]:
        print(f"notice: {printable(str(notice))}", file=sys.stderr)
    if len(notices) > _NOTICES:
        print(f"and {len(notices) - _NOTICES} more notices: see percept validate", file=sys.stderr)


def verdict(study: Study) -> int:
    """Say on standard error what the gate withholds, or the error it lets pass; return the exit code."""
    from percept.errors import RefusalError, printable

    fit = study.fit
    if fit is None or fit.run.gate.passed:
        tell_error(study)
        return 0
    reasons = printable(" ".join(fit.run.gate.reasons))
    print(f"percept: Bayesian intervals are withheld: {reasons}", file=sys.stderr)
    return RefusalError.exit_code


def tell_error(*studies: Study) -> None:
    """Say on standard error that Bayesian numbers are less accurate than asked."""
    from percept.errors import printable

    for study in studies:
        gate = study.fit.run.gate if study.fit is not None else None
        if gate is not None and gate.passed and not gate.tolerance_met:
            print(f"percept: {printable(gate.error_reached)}", file=sys.stderr)


def _store(arguments: argparse.Namespace, scene: Scene) -> RunStore | None:
    if arguments.no_cache or scene.inference.method == "classical":
        return None
    from percept.cache import PosteriorCache, cache_folder

    folder = cache_folder()
    return None if folder is None else PosteriorCache(folder)
