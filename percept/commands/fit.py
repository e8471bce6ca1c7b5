"""`percept fit`, `report`, `predict` and `batch`: analyses of one study, and of many."""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from percept.commands import FORCE, JSON, Command, argument, flag, folder, number
from percept.commands.analysis import (
    SETTINGS,
    STUDY,
    WORKERS,
    Working,
    checks_argument,
    open_mapper,
    open_study,
    print_json,
    print_table,
    read_scene,
    settings,
    show,
    tell_error,
    verdict,
)
from percept.errors import UsageError, counted, printable

if TYPE_CHECKING:
    from percept.batch import Summary


_PREDICTED = ["parameter", "reference", "kind", "lower", "upper", "estimate", "unit", "monte_carlo"]
_FIT_FILES = ("fit.json", "posterior.nc")
# Rows printed: what a terminal shows at once.
_MOST_ROWS = 30
# Folder of a report.
_OUT = "report"
_BATCH = """Fit many studies on the cores of this machine or on a dask cluster.

Each STUDY is a session file or a folder of them (with a scene.toml of its own where it differs).
DIR/batch.csv has the intervals of all. A bad study stops no other, and an interrupted batch goes on
when started again. Exit code 1: some study failed, was refused or has no Bayesian numbers.
"""


def _fit(arguments: argparse.Namespace) -> int:
    """Write DIR/fit.json and DIR/posterior.nc, and print the intervals."""
    from percept.files import filled_folder

    with Working("fitting", shown=not arguments.quiet) as progress:
        study = open_study(arguments, progress)
        with filled_folder(arguments.out, _FIT_FILES, force=arguments.force) as into:
            results = study.results(curves=False, progress=progress.stage)
            document = results.to_json()
            (into / "fit.json").write_text(document, encoding="utf-8")
            draws = study.posterior_file()
            if draws is not None:
                (into / "posterior.nc").write_bytes(draws)
    if arguments.json:
        print(document)
        return verdict(study)
    table = study.summary(None)
    if not table.empty:
        table = table.drop(columns=[name for name in table.columns if name.endswith("_estimate")])
        table = table.rename(columns={"environment": study.scene.environment_noun[0]})
        print_table(table.head(_MOST_ROWS), digits=6)
    if len(table) > _MOST_ROWS:
        print(f"These are {_MOST_ROWS} of {len(table):,} rows; fit.json has all.")
    for part in results.skipped:
        show(f"Left out: {part.what} ({part.why.removesuffix('.')}).")
    loo = results.checks.loo if results.checks else None
    if loo is not None:
        show("\n".join(loo.messages) or "No subject lies far from what the others predict.")
    print(Path(arguments.out) / "fit.json")
    return verdict(study)


def _report(arguments: argparse.Namespace) -> int:
    """Write the report, and print its findings, warnings and path; or print a line alone."""
    if arguments.results:
        return _report_again(arguments)
    if not arguments.sessions:
        raise UsageError("there are no sessions.", hint="Name files or folders, or give --from.")
    from percept.workers import beside

    with Working("writing the report", shown=not arguments.quiet) as progress:
        study = open_study(arguments, progress)
        options = {"why": arguments.why, "progress": progress.stage, "beside": beside}
        if _is_line_alone(arguments):
            answer = study.decide(**options)
        else:
            page = study.report(
                arguments.out or _OUT,
                formats=arguments.formats,
                force=arguments.force,
                **options,
            )
    if _is_line_alone(arguments):
        show(answer[0])
    else:
        _say_answer(page, arguments)
    return verdict(study)


def _report_again(arguments: argparse.Namespace) -> int:
    """Make page, tables and figures again from a report.json, or print its answer."""
    from percept.report import rewrite_report
    from percept.report.overview import decide
    from percept.results import Results

    changes = {"scene": arguments.scene, "why": arguments.why or None, **settings(arguments)}
    given = [f"--{name}" for name, value in changes.items() if value is not None]
    if arguments.sessions or given:
        raise UsageError(
            "--from takes results as they are.",
            hint=f"Leave out {', '.join(given) or 'the sessions'}.",
        )
    if _is_line_alone(arguments):
        show(decide(Results.load(arguments.results))[0])
        return 0
    with Working("writing the report", shown=not arguments.quiet) as progress:
        page = rewrite_report(
            arguments.results,
            arguments.out or _OUT,
            formats=arguments.formats,
            progress=progress.stage,
            force=arguments.force,
        )
    _say_answer(page, arguments)
    return 0


def _is_line_alone(arguments: argparse.Namespace) -> bool:
    """Say whether to print the one-line answer alone, and write no page."""
    return arguments.short and arguments.out is None


def _say_answer(page: Path, arguments: argparse.Namespace) -> None:
    """Print the findings, warnings and path of a page, or a line alone.

    What `verdict` says stands on standard error.
    """
    summary = json.loads((page.parent / "report.json").read_text(encoding="utf-8"))["summary"]
    if arguments.short:
        show(summary["sentences"][0])
        return
    if not arguments.quiet:
        told = ("There are no Bayesian intervals", "The Monte Carlo error reached")
        warnings = [f"warning: {said}" for said in summary["cautions"] if not said.startswith(told)]
        show("\n".join([*summary["sentences"], *warnings]))
    print(page)


def _predict(arguments: argparse.Namespace) -> None:
    """Print how far the environment lies from the tested ones, and its intervals."""
    from percept.study.prediction import predict

    with Working("predicting", shown=not arguments.quiet) as progress:
        study = open_study(arguments, progress)
        references = dict(arguments.at)
        prediction = predict(study, stiffness=arguments.k, damping=arguments.b, at=references)
    tell_error(study)
    if arguments.json:
        properties = {"sentence": prediction.sentence, "extrapolates": prediction.extrapolates}
        print_json({**properties, **vars(prediction)})
        return
    show(prediction.sentence)
    columns = list(_PREDICTED)
    if prediction.intervals["environment"].nunique() > 1:
        columns.insert(0, "environment")
    print_table(prediction.intervals, columns, digits=6)
    for row in prediction.intervals.drop_duplicates("kind").to_dict("records"):
        show(f"{row['kind']}: {row['covers'].replace(', in ' + row['unit'], '')}")
    worst = float(prediction.intervals["monte_carlo"].max())
    tolerance = study.scene.inference.tolerance
    if worst > tolerance:
        print(
            f"percept: these limits have Monte Carlo errors of up to {worst:.2%} of a half-width,"
            f" more than the fit's {tolerance:.2%}. Ask for a smaller tolerance.",
            file=sys.stderr,
        )
    if prediction.boundaries:
        print(f"{len(prediction.boundaries)} boundaries of abs(Z_h) were drawn too: see --json.")
    for part in prediction.skipped:
        print(f"percept: not computed: {part.what}: {part.why}.", file=sys.stderr)


def _reference(text: str) -> tuple[str, float]:
    """Read a reference such as "duration=500"."""
    name, _, value = text.partition("=")
    try:
        return name, float(value)
    except ValueError:
        message = f"{text!r}: a reference is written NAME=X, as in duration=500"
        raise argparse.ArgumentTypeError(message) from None


def _batch(arguments: argparse.Namespace) -> int:
    """Analyse the studies and print what became of them."""
    from percept.batch import run_batch, sources

    scene = read_scene(arguments)
    changes = settings(arguments)
    scene.with_inference(**changes)  # a wrong setting is wrong once, not once per study
    studies = sources(arguments.studies, scene=scene, changes=changes)
    with (
        Working("reading", shown=not arguments.quiet) as working,
        open_mapper(arguments) as mapper,
    ):

        def show(summary: Summary) -> None:
            finished = summary.counts.total()
            bad = len(summary.failures)
            words = f"{finished} of {summary.studies} studies, {bad} refused or failed"
            working.show(words, finished, summary.studies)

        summary = run_batch(studies, arguments.out, mapper, progress=show, force=arguments.force)
    if arguments.json:
        print_json({**vars(summary), "table": str(summary.table)})
    else:
        _print_summary(summary)
    return int(bool(summary.failures))


def _print_summary(summary: Summary) -> None:
    """Print what became of the studies; what is wrong goes to standard error."""
    for name, message in (*summary.failures, *summary.inaccurate):
        told = message if message.startswith(name) else f"{name}: {message}"
        print(printable(told), file=sys.stderr)
    words = ", ".join(f"{count} {status}" for status, count in sorted(summary.counts.items()))
    studies = counted(summary.studies, "study", "studies")
    now = summary.studies - summary.skipped
    print(f"{studies} ({words}): {summary.skipped} finished before, {now} now")
    print(summary.table)


FIT = Command(
    "Fit the model and write the intervals: fit.json (in report.json's schema) and the posterior.",
    "percept fit sessions.csv --scene scene.toml --out results --json",
    (
        *STUDY,
        checks_argument(usual=False),
        folder("fit"),
        JSON,
        FORCE,
    ),
    _fit,
)
REPORT = Command(
    "Analyse sessions and write the report: page, report.json, tables, figures and posterior.",
    "percept report sessions/ --scene scene.toml --out results",
    (
        argument("sessions", "PATH", "session files or folders, or a published summary", nargs="*"),
        *STUDY[1:],
        argument(
            "--from", "FILE", "make it again from this report.json, without data", dest="results"
        ),
        checks_argument(usual=True),
        argument("--out", "DIR", "folder to write into (report)"),
        flag("--why", "say why the methods differ; samples the models between them"),
        flag("--short", "print the answer in one line; write the report only with --out"),
        argument(
            "--formats",
            "FORM",
            "files of the figures: svg, pdf, png (svg)",
            nargs="+",
            default=["svg"],
        ),
        FORCE,
    ),
    _report,
)
PREDICT = Command(
    "Predict intervals and the boundary of an environment nobody tested.",
    "percept predict sessions.csv --k 15000 --b 12 --scene scene.toml",
    (
        *STUDY,
        number("--k", "N/m", "stiffness of the untested environment"),
        number("--b", "N·s/m", "damping of the untested environment"),
        argument(
            "--at",
            "NAME=X",
            "other references, in their units",
            type=_reference,
            nargs="+",
            default=[],
        ),
        JSON,
    ),
    _predict,
)
BATCH = Command(
    _BATCH,
    "percept batch studies/* --scene scene.toml --workers 8 --out results",
    (
        argument("studies", "STUDY", "a session file or folder", nargs="+"),
        *SETTINGS,
        *WORKERS,
        folder("batch"),
        JSON,
        FORCE,
    ),
    _batch,
)
