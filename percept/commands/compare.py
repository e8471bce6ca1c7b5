"""`percept compare`: two methods on one study, or two studies, groups, conditions or devices."""

from __future__ import annotations

import argparse
import dataclasses
import itertools
import math
from typing import TYPE_CHECKING

from percept.commands import JSON, Command, argument
from percept.commands.analysis import (
    STUDY,
    Working,
    open_study,
    print_json,
    print_table,
    show,
    tell_error,
)
from percept.errors import RefusalError, UsageError, capitalised

if TYPE_CHECKING:
    import pandas as pd

    from percept.study import Study


_PAIRS = [
    "environment",
    "parameter",
    "kind",
    "classical_lower",
    "classical_upper",
    "bayesian_lower",
    "bayesian_upper",
    "width_ratio",
    "shift",
]
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
    "probability_above",
    "d_z",
    "n",
]
_OF_RATIOS = {"spread": "ratio of SDs between users", "precision": "ratio of SDs between trials"}
_ANOVA = [
    "factor",
    "parameter",
    "f",
    "df_corrected",
    "df_error_corrected",
    "epsilon",
    "p_corrected",
    "partial_eta2",
    "generalised_eta2",
    "n",
]
# Boundaries printed: what a terminal shows at once.
_MOST_CURVES = 10
_STEPS_LEGEND = """width: ratio of widths; centre: shift in classical half-widths;
error: Monte Carlo standard error (log_width_error: of the ratio's logarithm)."""

_ANOVA_LEGEND = """epsilon: Greenhouse and Geisser's, by which the degrees of
freedom (df) are multiplied; eta2: share of the variance that the term explains."""
_LEGEND = """Exact envelopes, where they differ most over omega (rad/s), and the median.
place: middle over the other one's, less one; width: logarithm of the ratio."""


def _run(arguments: argparse.Namespace) -> None:
    """Compare methods for one path, studies for two, groups or conditions for a column."""
    with Working("comparing", shown=not arguments.quiet) as progress:
        if arguments.by:
            _by_column(arguments, progress)
        elif len(arguments.sessions) == 1 and not arguments.other_scene:
            _methods(open_study(arguments, progress), arguments, progress)
        else:
            _two_studies(arguments, progress)


def _two_studies(arguments: argparse.Namespace, progress: Working) -> None:
    """Print how two paths differ, or one path under two scenes."""
    from percept.study.compare import compare_studies

    paths = arguments.sessions
    if len(paths) > 2:
        raise UsageError("compare takes one or two studies; put the files of a study in a folder.")
    names = {}
    studies = {}
    scenes = {"a": arguments.scene, "b": arguments.other_scene or arguments.scene}
    for letter, path in (("a", paths[0]), ("b", paths[-1])):
        scene = scenes[letter]
        names[letter] = f"{path} under {scene}" if scene else path
        chosen = argparse.Namespace(**vars(arguments) | {"sessions": [path], "scene": scene})
        studies[letter] = open_study(chosen, progress)
    comparison = compare_studies(studies["a"], studies["b"])
    progress.stop()
    tell_error(*studies.values())
    asked = studies["a"].scene.inference
    if arguments.json:
        verdicts = {letter: study.verdict_rows for letter, study in studies.items()}
        stated = {"studies": names, "level": asked.level, "family": asked.family}
        print_json({**stated, "verdicts": verdicts, **vars(comparison)})
        return
    lines = [f"{letter.upper()}: {name}" for letter, name in names.items()]
    lines += [*comparison.notes, f"Both: {_claim(studies['a'])}."]
    for letter, study in studies.items():
        lines += [f"{letter.upper()}: {said}" for said in _feelings(study)]
    show("\n".join(lines))
    if len(comparison.differences):
        _print_contrasts(comparison.differences)
    elif not len(comparison.curves):
        print_table(comparison.intervals, head="Intervals of A and B; width ratio B/A:")
    if len(comparison.curves):
        widest = comparison.curves["place"].abs().sort_values(ascending=False, kind="stable")
        farthest = widest.index[:_MOST_CURVES]
        count = len(comparison.curves)
        head = f"The {len(farthest)} of {count} boundaries farthest apart, B against A. {_LEGEND}"
        print_table(comparison.curves.loc[farthest], head=head)


def _by_column(arguments: argparse.Namespace, progress: Working) -> None:
    """Compare the levels of a column, of conditions or of groups of subjects, in one model."""
    column = arguments.by
    if arguments.other_scene:
        raise UsageError("--by compares groups under one scene; leave --other-scene out.")
    study = open_study(arguments, progress, by=column)
    is_shown = [column in row.factor.split(":") for row in study.contrast_rows]
    rows = list(itertools.compress(study.contrast_rows, is_shown))
    tests = [row for row in study.anova if column in row.factor.split(":")]
    skipped = study.skipped_of("contrast_rows", "anova")
    notes = [f"{part.what}: {part.why}" for part in skipped]
    progress.stop()
    if not rows:
        raise RefusalError("no contrast can be worked out.", column=column, hint="; ".join(notes))
    factors = study.sessions.factors
    levels = factors.levels.get(column, ()) if factors else ()
    asked = study.scene.inference
    if arguments.json:
        stated = {"factor": column, "levels": levels, "level": asked.level, "family": asked.family}
        print_json({**stated, "notes": notes, "contrast": rows, "anova": tests})
        return
    if levels:
        within = all(row.within for row in rows if row.factor == column)
        who = "the same subjects" if within else "different subjects"
        notes.insert(0, f"{column}: {who} at {', '.join(levels)}.")
    show("\n".join([*notes, f"{capitalised(_claim(study))}."]))
    _print_contrasts(study.contrasts.loc[is_shown])
    if tests:
        print_table(tests, _ANOVA, head=f"Analysis of variance. {_ANOVA_LEGEND}")


def _print_contrasts(contrasts: pd.DataFrame) -> None:
    """Print contrasts, a table for each pair of levels and each unit."""
    by_head = contrasts.groupby(["of", "second", "first", "unit"], sort=False)
    for (of, second, first, unit), rows in by_head:
        measure = f"difference, in {unit}" if str(unit) else _OF_RATIOS.get(str(of), "ratio")
        head = f"{str(of).capitalize()}, {second} against {first}, {measure}:"
        print_table(rows.fillna({"environment": "overall"}), _CONTRAST, head=head)


def _methods(study: Study, arguments: argparse.Namespace, progress: Working) -> None:
    """Print the comparison of the two methods on one study."""
    import pandas as pd

    method = study.scene.inference.method
    if method != "both":
        hint = 'Set method = "both", or give a second study.'
        raise RefusalError(
            f"only the {method} method was asked for, and nothing to compare it with.", hint=hint
        )
    pairs = study.comparison
    ladder = study.ladder
    if not pairs or ladder is None:
        skipped = study.skipped_of("prepared", "interval_rows")
        whys = [part.why for part in skipped if part.what == "Bayesian intervals"]
        hint = "; ".join(whys) or "percept fit prints what intervals there are."
        raise RefusalError("no interval of one method has a counterpart in the other.", hint=hint)
    table = pd.DataFrame(pairs).merge(study.summary(None))
    progress.stop()
    tell_error(study)
    asked = study.scene.inference
    if arguments.json:
        stated = {"level": asked.level, "family": asked.family, "comparison": table}
        bands = {"band_pairs": study.band_pairs}
        print_json({**stated, "verdicts": study.verdict_rows, "ladder": ladder, **bands})
        return
    claim = _claim(study)
    print_table(table, _PAIRS, head=f"Intervals in pairs, {claim}:")
    show("\n".join(["", *_feelings(study)]))
    if study.band_pairs:
        head = f"Boundaries in pairs, Bayesian against classical, {claim}. {_LEGEND}"
        print_table(study.band_pairs, head=head)
    show("\nWhy they differ, step by step from the classical interval of the normal family:")
    show("\n".join(ladder.notes))
    kind = asked.kinds[0]
    effects = []
    for effect in ladder.effects:
        if effect.kind == kind:
            effects.append({**vars(effect), "width": math.exp(effect.log_width)})
    print_table(effects, _STEPS, head=f"The steps of kind {kind}. {_STEPS_LEGEND}")


def _feelings(study: Study) -> list[str]:
    """Say what feels real in a study, as its page does."""
    from percept.report.decisions import feeling_sentences

    results = study.results(curves=False)
    judged = dataclasses.replace(results, verdicts=study.verdict_rows, rendering=study.rendering)
    return feeling_sentences(judged)


def _claim(study: Study) -> str:
    from percept.inference.record import percent

    return f"{study.scene.inference.family} family, level {percent(study.scene.inference.level)}"


COMPARE = Command(
    "Compare the two methods on one study, or two studies, groups of subjects or devices.",
    "percept compare study_a.csv study_b.csv --scene scene.toml",
    (
        *STUDY,
        argument("--other-scene", "FILE", "scene of the second study, such as another device"),
        argument("--by", "COLUMN", "compare the groups, or conditions, in this column"),
        JSON,
    ),
    _run,
)
