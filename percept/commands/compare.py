"""`percept compare`: two methods on one study, or two studies, groups of subjects, conditions or devices."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING, Any

from percept.commands import JSON, Command, argument
from percept.commands.analysis import (
    STUDY,
    Working,
    in_words_of,
    open_study,
    print_json,
    settings,
    show,
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
_CONTRAST = [
    "environment",
    "parameter",
    "kind",
    "method",
    "lower",
    "estimate",
    "upper",
    "p_value",
    "error",
    "n",
]
_MOST_CURVES = 10
_CURVES = """area: mean over log omega of
abs(log(B/A)) of the lower and the upper curve; largest: log(B/A) at that omega (rad/s)."""
_STEPS_SAY = """width: ratio of widths; centre: shift in classical half-widths;
error: Monte Carlo standard error (log_width_error: of the ratio's logarithm)."""


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
            studies = [
                (f"{column} {group}", study.over(sessions)) for group, sessions in groups.items()
            ]
        elif len(paths) == 1 and not arguments.other_scene:
            return _methods(open_study(arguments, progress), arguments, progress)
        elif len(paths) > 2:
            raise UsageError(
                "compare takes one or two studies; put the files of a study in a folder."
            )
        else:
            studies = []
            for path, scene in zip(
                (paths[0], paths[-1]), (None, arguments.other_scene), strict=True
            ):
                own = vars(arguments) | {"sessions": [path], "scene": scene or arguments.scene}
                name = f"{path} under {own['scene']}" if own["scene"] else path
                studies.append((name, open_study(argparse.Namespace(**own), progress)))
        (name_a, a), (name_b, b) = studies
        found = compare_studies(a, b)
    tell_error(a, b)
    if arguments.json:
        return print_json({"studies": {"a": name_a, "b": name_b}, **_stated(a), **vars(found)})
    show("\n".join([f"A: {name_a}", f"B: {name_b}", *map(in_words_of(a.scene), found.notes)]))
    show(f"Both: {_claim(a)}.")
    if len(found.differences):
        unit = "ratio B/A" if a.scene.inference.family == "lognormal" else "difference B - A"
        _print(f"Average users, {unit}; spread between users, ratio B/A:", found.differences)
    elif not len(found.curves):
        _print("Intervals of A and B; width ratio B/A:", found.intervals)
    if len(found.curves):
        areas = found.curves[["area_lower", "area_upper"]].max(axis=1)
        worst = found.curves.loc[
            areas.sort_values(ascending=False, kind="stable").index[:_MOST_CURVES]
        ]
        head = f"The {len(worst)} of {len(found.curves)} boundaries farthest apart. {_CURVES}"
        _print(head, worst)
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
    if table.empty:
        raise RefusalError(
            "no contrast can be worked out.", column=factor.name, hint="; ".join(notes)
        )
    if arguments.json:
        stated = {"factor": factor.name, "levels": factor.levels, **_stated(study), "notes": notes}
        return print_json({**stated, "contrast": table})
    show("\n".join([f"{factor.name}: the same subjects at {', '.join(factor.levels)}.", *notes]))
    show(f"Paired, {_claim(study)}.")
    table = table.assign(environment=table["environment"].fillna("overall"))
    for names, alike in table.groupby(["first", "second", "of", "unit"], sort=False):
        first, second, of, unit = map(str, names)
        measure = "ratio of SDs between users" if of == "spread" else "ratio"
        if unit:
            measure = f"difference, in {unit}"
        _print(f"{of.capitalize()}, {second} against {first}, {measure}:", alike[_CONTRAST])
    return None


def _methods(study: Study, arguments: argparse.Namespace, progress: Working) -> None:
    """Print the comparison of the two methods on one study."""
    import numpy as np

    from percept.calibration.advice import recommend

    table, ladder, method = study.comparison, study.ladder, study.scene.inference.method
    if method != "both":
        hint = 'Set method = "both", or give a second study.'
        raise RefusalError(
            f"only the {method} method was asked for, and nothing to compare it with.", hint=hint
        )
    if table is None or table.empty or ladder is None:
        why = dict(study.skipped_before_curves).get(
            "Bayesian intervals", "percept fit prints what intervals there are."
        )
        raise RefusalError("no interval of one method has a counterpart in the other.", hint=why)
    progress.stop()
    tell_error(study)
    asked = {"scene": arguments.scene, **settings(arguments), "out": arguments.coverage}
    flags = [f"--{name} {value}" for name, value in asked.items() if value is not None]
    command = " ".join(["percept calibrate", *arguments.sessions, *flags, "--advice"])
    advice = recommend(study, arguments.coverage, command)
    if arguments.json:
        return print_json(
            {**_stated(study), "comparison": table, "ladder": ladder, "advice": advice}
        )
    _print(f"Intervals in pairs, {_claim(study)}:", table[_PAIRS])
    show("\nWhy they differ, step by step from the classical interval of the normal family:")
    show("\n".join(map(in_words_of(study.scene), [*ladder.sentences, *ladder.notes, "", *advice])))
    kind, effects = study.scene.inference.kinds[0], ladder.effects
    steps = effects.assign(width=np.exp(effects["log_width"]))[effects["kind"] == kind]
    _print(f"The steps of kind {kind}. {_STEPS_SAY}", steps[_STEPS])
    return None


def _stated(study: Study) -> dict[str, Any]:
    """Return what the intervals of a comparison claim."""
    return study.scene.inference.model_dump(include={"level", "family"})


def _claim(study: Study) -> str:
    from percept.inference.record import percent

    return f"{study.scene.inference.family} family, level {percent(study.scene.inference.level)}"


def _print(head: str, table: pd.DataFrame) -> None:
    shown = table.dropna(axis=1, how="all")
    show(f"\n{head}\n{shown.to_string(index=False, float_format='{:.4g}'.format, na_rep='-')}")


COMPARE = Command(
    "Compare the two methods on one study, or two studies, groups of subjects or devices.",
    "percept compare study_a.csv study_b.csv --scene scene.toml",
    (
        *STUDY,
        argument("--other-scene", "FILE", "scene of the second study, such as another device"),
        argument("--by", "COLUMN", "compare the groups, or conditions, in this column"),
        argument(
            "--coverage",
            "DIR",
            "where percept calibrate --advice wrote what recommends a method (coverage)",
            default="coverage",
        ),
        JSON,
    ),
    _run,
)
