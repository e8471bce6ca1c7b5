"""Compare the two methods on one study, or two studies, groups of subjects or devices."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING, Any

from percept.commands.analysis import add_analysis_arguments, open_study, tell_error
from percept.commands.progress import Working

if TYPE_CHECKING:
    import pandas as pd

    from percept.study import Study

EXAMPLE = "percept compare study_a.csv study_b.csv --scene scene.toml"
_CELL = ["environment", "parameter", "kind"]
_PAIR = [
    "lower_classical", "upper_classical", "lower_bayesian", "upper_bayesian",
    "width_ratio", "shift", "overlap",
]  # fmt: skip
_REASONS = [
    "spread_ratio", "certainty_ratio", "shift_sds", "prior_lower", "prior_upper", "scale_ratio",
    "to_mean_classical", "to_mean_bayesian",
]  # fmt: skip
_MOST_CURVES = 10


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    add_analysis_arguments(parser)
    parser.add_argument(
        "--other-scene", metavar="FILE", help="scene of the second study, such as another device"
    )
    parser.add_argument("--by", metavar="COLUMN", help="compare the two groups of subjects in this column")
    parser.add_argument("--json", action="store_true", help="print as JSON")


def run(arguments: argparse.Namespace) -> int:
    """Print the methods' comparison for one path, the difference of the studies for two."""
    from percept.study.pairs import compare_studies

    with Working("comparing", shown=not arguments.quiet) as progress:
        pair = _pair(arguments, progress)
        if pair is None:
            study = open_study(arguments, progress)
            return _methods(study, as_json=arguments.json)
        studies, names = pair
        found = compare_studies(*studies)
    tell_error(*studies)
    if arguments.json:
        parts = {"intervals": found.intervals, "differences": found.differences, "curves": found.curves}
        _print_json({"studies": names, **_stated(studies[0]), "notes": found.notes, **parts})
        return 0
    unit = "ratio B/A" if studies[0].scene.inference.family == "lognormal" else "difference B - A"
    print("\n".join([f"A: {names['a']}", f"B: {names['b']}", *found.notes]))
    print(f"Both: {_claim(studies[0])}.")
    if len(found.differences):
        print(f"\nAverage users, {unit}; spread between users, ratio B/A:")
        _print(found.differences)
    elif not len(found.curves):
        print("\nIntervals of A and B; width ratio B/A:")
        _print(found.intervals)
    _print_curves(found.curves, "B/A")
    return 0


def _pair(
    arguments: argparse.Namespace, progress: Working
) -> tuple[tuple[Study, Study], dict[str, str]] | None:
    """Two studies and what they are; None where one path and one scene are given."""
    from percept.errors import UsageError

    paths = arguments.sessions
    scenes = (arguments.scene, arguments.other_scene or arguments.scene)
    if arguments.by:
        if arguments.other_scene:
            raise UsageError("--by compares groups under one scene; leave --other-scene out.")
        return _groups(open_study(arguments, progress, groups=[arguments.by]), arguments.by)
    if len(paths) == 1 and not arguments.other_scene:
        return None
    if len(paths) > 2:
        raise UsageError("compare takes one or two studies; put the files of a study in a folder.")
    first, second = (
        open_study(argparse.Namespace(**{**vars(arguments), "sessions": [path], "scene": scene}), progress)
        for path, scene in zip((paths[0], paths[-1]), scenes, strict=True)
    )
    a, b = (
        f"{path} under {scene}" if scene else path
        for path, scene in zip((paths[0], paths[-1]), scenes, strict=True)
    )
    return (first, second), {"a": a, "b": b}


def _groups(study: Study, column: str) -> tuple[tuple[Study, Study], dict[str, str]]:
    from percept.errors import UsageError
    from percept.study.pairs import split_by

    groups = split_by(study.sessions, column)
    if len(groups) > 2:
        raise UsageError(
            f"there are {len(groups)} groups, {', '.join(groups)}; two can be compared.",
            column=column,
            hint=f"Keep two in the scene: [sessions] only.{column}.",
        )
    a, b = groups
    return (study.over(groups[a]), study.over(groups[b])), {"a": f"{column} {a}", "b": f"{column} {b}"}


def _methods(study: Study, *, as_json: bool) -> int:
    from percept.errors import RefusalError

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
    tell_error(study)
    curves = study.curve_comparison
    if as_json:
        _print_json({**_stated(study), "comparison": table, "curves": curves})
        return 0
    print(f"Intervals in pairs, {_claim(study)}:")
    _print(table[_CELL + _PAIR])
    reasons = [name for name in _REASONS if name in table]
    print("\nWhy they differ (width ratio on the family's scale: spread_ratio times certainty_ratio):")
    _print(table[_CELL + reasons])
    if "prior_effective" in table:
        print(f"The pull of the priors rests on {table['prior_effective'].iloc[0]:.0f} effective draws.")
    _print_curves(curves, "Bayesian/classical")
    return 0


def _stated(study: Study) -> dict[str, Any]:
    """Return what the intervals of a comparison claim."""
    asked = study.scene.inference
    return {"level": asked.level, "family": asked.family}


def _claim(study: Study) -> str:
    from percept.inference.record import percent

    asked = study.scene.inference
    return f"{asked.family} family, level {percent(asked.level)}"


def _print_curves(curves: pd.DataFrame, ratio: str) -> None:
    """Print the boundaries farthest from each other."""
    if not len(curves):
        return
    areas = curves[["area_lower", "area_upper"]].max(axis=1)
    worst = curves.loc[areas.sort_values(ascending=False, kind="stable").index[:_MOST_CURVES]]
    print(f"\nThe {len(worst)} of {len(curves)} boundaries farthest apart. area: mean over log omega of")
    print(f"abs(log({ratio})) of the lower and the upper curve; largest: log({ratio}) at that omega (rad/s).")
    _print(worst)


def _print(table: pd.DataFrame) -> None:
    shown = table.dropna(axis=1, how="all")
    print(shown.to_string(index=False, float_format="{:.4g}".format, na_rep="-"))


def _print_json(parts: dict[str, Any]) -> None:
    from percept.report.plain import dumps, plain

    print(dumps(plain(parts)), end="")
