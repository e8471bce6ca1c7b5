"""`percept compare`: two methods on one study, or two studies, groups of subjects, conditions or devices."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING, Any

from percept.commands import Command
from percept.commands.analysis import (
    Working,
    add_analysis_arguments,
    in_words_of,
    open_study,
    print_json,
    settings,
    tell_error,
)
from percept.errors import RefusalError, UsageError

if TYPE_CHECKING:
    import pandas as pd

    from percept.study import Study

_PAIRS = [
    "environment", "parameter", "kind", "lower_classical", "upper_classical", "lower_bayesian",
    "upper_bayesian", "width_ratio", "shift", "overlap",
]  # fmt: skip
_STEPS = ["environment", "parameter", "cause", "width", "log_width_error", "centre", "centre_error"]
_CONTRAST = ["environment", "parameter", "kind", "method", "lower", "estimate", "upper", "p_value", "n"]
_MOST_CURVES = 10


def _add_arguments(parser: argparse.ArgumentParser) -> None:
    add_analysis_arguments(parser)
    parser.add_argument(
        "--other-scene", metavar="FILE", help="scene of the second study, such as another device"
    )
    parser.add_argument("--by", metavar="COLUMN", help="compare the groups, or conditions, in this column")
    parser.add_argument(
        "--coverage",
        default="coverage",
        metavar="DIR",
        help="where percept calibrate --advice wrote what recommends a method (coverage)",
    )
    parser.add_argument("--json", action="store_true", help="print as JSON")


def _run(arguments: argparse.Namespace) -> None:
    """Print the methods' comparison for one path, the difference of the studies for two."""
    from percept.sessions.read import by_level
    from percept.study.compare import compare_studies, split_by, within_subjects

    paths, column = arguments.sessions, arguments.by
    with Working("comparing", shown=not arguments.quiet) as progress:
        if column:
            if arguments.other_scene:
                raise UsageError("--by compares groups under one scene; leave --other-scene out.")
            study = open_study(arguments, progress, groups=[column])
            if within_subjects(study.sessions, column):
                return _contrasts(study.over(by_level(study.sessions, column)), arguments, progress)
            groups = split_by(study.sessions, column)
            if len(groups) > 2:
                raise UsageError(
                    f"there are {len(groups)} groups, {', '.join(groups)}; two can be compared.",
                    column=column,
                    hint=f"Keep two in the scene: [sessions] only.{column}.",
                )
            studies = {f"{column} {group}": study.over(sessions) for group, sessions in groups.items()}
            names, (a, b) = list(studies), studies.values()
        elif len(paths) == 1 and not arguments.other_scene:
            return _methods(open_study(arguments, progress), arguments, progress)
        elif len(paths) > 2:
            raise UsageError("compare takes one or two studies; put the files of a study in a folder.")
        else:
            both = [(paths[0], arguments.scene), (paths[-1], arguments.other_scene or arguments.scene)]
            names = [f"{path} under {scene}" if scene else path for path, scene in both]
            a, b = (
                open_study(
                    argparse.Namespace(**vars(arguments) | {"sessions": [path], "scene": scene}), progress
                )
                for path, scene in both
            )
        comparison = compare_studies(a, b)
    tell_error(a, b)
    if arguments.json:
        tables = {name: getattr(comparison, name) for name in ("intervals", "differences", "curves")}
        studies_named = dict(zip("ab", names, strict=True))
        return print_json({"studies": studies_named, **_stated(a), "notes": comparison.notes, **tables})
    unit = "ratio B/A" if a.scene.inference.family == "lognormal" else "difference B - A"
    notes = map(in_words_of(a.scene), comparison.notes)
    print("\n".join([f"A: {names[0]}", f"B: {names[1]}", *notes]))
    print(f"Both: {_claim(a)}.")
    if len(comparison.differences):
        print(f"\nAverage users, {unit}; spread between users, ratio B/A:")
        _print(comparison.differences)
    elif not len(comparison.curves):
        print("\nIntervals of A and B; width ratio B/A:")
        _print(comparison.intervals)
    if len(comparison.curves):
        _print_curves(comparison.curves)
    return None


def _contrasts(study: Study, arguments: argparse.Namespace, progress: Working) -> None:
    """Print the contrasts of conditions that the same subjects went through."""
    import pandas as pd

    from percept.study.basics import Skipped, results
    from percept.study.contrasts import contrast_rows

    how = {"progress": study.progress, "store": study.store}
    rows = list(contrast_rows(study.sessions, study.parameters, study.scene, **how))
    table, factor = pd.DataFrame(results(rows)), study.sessions.factor
    assert factor is not None
    notes = [f"{row.what}: {row.why}" for row in rows if isinstance(row, Skipped)]
    progress.stop()
    if not len(table):
        raise RefusalError("no contrast can be worked out.", column=factor.name, hint="; ".join(notes))
    if arguments.json:
        stated = {"factor": factor.name, "levels": factor.levels, **_stated(study), "notes": notes}
        return print_json({**stated, "contrast": table.to_dict("records")})
    ratio = "ratio" if study.scene.inference.family == "lognormal" else "difference, in references"
    print("\n".join([f"{factor.name}: the same subjects at {', '.join(factor.levels)}.", *notes]))
    print(f"Paired, {_claim(study)}.")
    table = table.assign(environment=table["environment"].fillna("overall"))
    units = {"bias": ratio, "spread": "ratio of SDs between users"}
    for names, alike in table.groupby(["first", "second", "of"], sort=False):
        first, second, of = map(str, names)
        print(f"\n{of.capitalize()}, {second} against {first}, {units[of]}:")
        _print(alike[_CONTRAST])
    return None


def _methods(study: Study, arguments: argparse.Namespace, progress: Working) -> None:
    """Print the comparison of the two methods on one study."""
    import numpy as np

    from percept.calibration.coverage import recommend

    table = study.comparison
    if table is None:
        method = study.scene.inference.method
        if method != "both":
            raise RefusalError(
                f"only the {method} method was asked for: there is nothing to compare it with.",
                hint='Set method = "both", or give a second study.',
            )
        raise RefusalError(
            "the Bayesian intervals are withheld, and the others stand alone.",
            hint=dict(study.skipped)["Bayesian intervals"],
        )
    if table.empty:
        raise RefusalError(
            "no interval of one method has a counterpart in the other.",
            hint="percept fit prints the intervals there are, and why others are left out.",
        )
    ladder = study.ladder
    assert ladder is not None
    progress.stop()
    tell_error(study)
    asked = {"scene": arguments.scene, **settings(arguments), "out": arguments.coverage}
    flags = [f"--{name} {value}" for name, value in asked.items() if value is not None]
    command = " ".join(["percept calibrate", *arguments.sessions, *flags, "--advice"])
    advice = recommend(study, arguments.coverage, command)
    if arguments.json:
        found = {"comparison": table, "ladder": ladder, "advice": advice}
        return print_json({**_stated(study), **found})
    print(f"Intervals in pairs, {_claim(study)}:")
    _print(table[_PAIRS])
    kind, effects = study.scene.inference.kinds[0], ladder.effects
    print("\nWhy they differ, step by step from the classical interval of the normal family:")
    print("\n".join(map(in_words_of(study.scene), [*ladder.sentences, *ladder.notes, "", *advice])))
    print(f"\nThe steps of kind {kind}. width: ratio of widths; centre: shift in classical half-widths;")
    print("error: Monte Carlo standard error (log_width_error: of the ratio's logarithm).")
    _print(effects.assign(width=np.exp(effects["log_width"]))[effects["kind"] == kind][_STEPS])
    return None


def _stated(study: Study) -> dict[str, Any]:
    """Return what the intervals of a comparison claim."""
    return study.scene.inference.model_dump(include={"level", "family"})


def _claim(study: Study) -> str:
    from percept.inference.record import percent

    return f"{study.scene.inference.family} family, level {percent(study.scene.inference.level)}"


def _print_curves(curves: pd.DataFrame) -> None:
    """Print the boundaries farthest from each other."""
    areas = curves[["area_lower", "area_upper"]].max(axis=1)
    worst = curves.loc[areas.sort_values(ascending=False, kind="stable").index[:_MOST_CURVES]]
    print(f"\nThe {len(worst)} of {len(curves)} boundaries farthest apart. area: mean over log omega of")
    print("abs(log(B/A)) of the lower and the upper curve; largest: log(B/A) at that omega (rad/s).")
    _print(worst)


def _print(table: pd.DataFrame) -> None:
    shown = table.dropna(axis=1, how="all")
    print(shown.to_string(index=False, float_format="{:.4g}".format, na_rep="-"))


COMPARE = Command(
    "Compare the two methods on one study, or two studies, groups of subjects or devices.",
    "percept compare study_a.csv study_b.csv --scene scene.toml",
    _add_arguments,
    _run,
)
