"""`percept fit` and `percept report`: a study's intervals, and the whole page."""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable
from typing import TYPE_CHECKING

from percept.commands import FORCE, JSON, Command, argument, flag, folder
from percept.commands.analysis import (
    STUDY,
    Working,
    checks_argument,
    in_words_of,
    notice,
    open_study,
    show,
    verdict,
)

if TYPE_CHECKING:
    from percept.study import Study

_COLUMNS = [
    "environment",
    "parameter",
    "kind",
    "method",
    "family",
    "joint",
    "lower",
    "upper",
    "unit",
]
_MOST_ROWS = 30


def _fit(arguments: argparse.Namespace) -> int:
    """Write DIR/fit.json and DIR/posterior.nc, and print the intervals."""
    from percept.report import write_fit

    with Working("fitting", shown=not arguments.quiet) as progress:
        study = open_study(arguments, progress)
        path = write_fit(study, arguments.out, force=arguments.force, say=notice)
    if arguments.json:
        print(path.read_text(encoding="utf-8"))
        return verdict(study)
    say = in_words_of(study.scene)
    _print_intervals(study, every=arguments.all)
    for row in json.loads(path.read_text(encoding="utf-8"))["skipped"]:
        print(say(f"Left out: {row['what']} ({row['why'].removesuffix('.')})."))
    _print_checks(study, say)
    print(path)
    return verdict(study)


def _print_intervals(study: Study, *, every: bool) -> None:
    """Print both methods side by side, or a row per interval."""
    if every:
        table = study.intervals[_COLUMNS]
    else:
        table = study.summary(None).head(_MOST_ROWS)
        table = table.drop(columns=[name for name in table.columns if name.endswith("_estimate")])
    if table.empty:
        return
    table = table.rename(columns={"environment": study.scene.environment_noun[0]})
    show(table.to_string(index=False, float_format="{:.6g}".format, na_rep="–"))
    if not every:
        print(
            f"--all prints all {len(study.intervals)} intervals: both families, and those that hold"
            " together."
        )


def _print_checks(study: Study, say: Callable[[str], str]) -> None:
    """Print what the checks say in words, where they were asked for."""
    if study.scene.checks is None or study.checks is None:
        return
    loo = study.checks.loo
    print(say(f"Predictive density of the subjects left out: {loo.elpd:.1f} ± {loo.se:.1f} nats."))
    for message in (
        *(loo.messages or ("No subject is influential or an outlier.",)),
        *study.checks.pull,
    ):
        print(say(message))


def _report(arguments: argparse.Namespace) -> int:
    """Write the report, with what the gate does not withhold; and print its findings, warnings and path."""
    from percept.report import write_report

    with Working("writing the report", shown=not arguments.quiet) as progress:
        study = open_study(arguments, progress)
        page = write_report(
            study,
            arguments.out,
            formats=arguments.formats,
            why=arguments.why,
            force=arguments.force,
            say=notice,
        )
    if not arguments.quiet:
        summary = json.loads((page.parent / "report.json").read_text(encoding="utf-8"))["summary"]
        # What `verdict` says stands on standard error.
        told = ("There are no Bayesian intervals", "The Monte Carlo error reached")
        warnings = [f"warning: {said}" for said in summary["cautions"] if not said.startswith(told)]
        print(
            "\n".join(map(in_words_of(study.scene), [*summary["overview"]["sentences"], *warnings]))
        )
    print(page)
    return verdict(study)


FIT = Command(
    "Fit the model and write the intervals: fit.json (in report.json's schema) and the posterior.",
    "percept fit sessions.csv --scene scene.toml --out results --json",
    (
        *STUDY,
        checks_argument(usual=False),
        folder("fit"),
        flag("--all", "print every interval: both families, joint ones too"),
        JSON,
        FORCE,
    ),
    _fit,
)
REPORT = Command(
    "Analyse sessions and write the report: page, report.json, tables, figures and posterior.",
    "percept report sessions/ --scene scene.toml --out results",
    (
        *STUDY,
        checks_argument(usual=True),
        folder("report"),
        flag("--why", "say why the methods differ; samples the models between them"),
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
