"""Flags that ask a fit or a report for checks of the hierarchical model."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from percept.scene import Scene
    from percept.study import Study


def add_check_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the keys of `[checks]`; each of them asks for the checks."""
    parser.add_argument(
        "--checks", action="store_true", help="check the model: subjects left out, predictions, priors"
    )
    parser.add_argument(
        "--refit", action="store_true", help="and sample anew without each influential subject"
    )
    parser.add_argument(
        "--models", action="store_true", help="and compare smaller models; samples four more posteriors"
    )


def with_checks(scene: Scene, arguments: argparse.Namespace) -> Scene:
    """Return the scene with what the flags ask for beside what it asks for itself."""
    flags = {name: bool(vars(arguments).get(name)) for name in ("checks", "refit", "models")}
    if not any(flags.values()):
        return scene
    asked = scene.checks
    return scene.with_tables(
        checks={
            "refit": flags["refit"] or (asked is not None and asked.refit),
            "compare": flags["models"] or (asked is not None and asked.compare),
        }
    )


def print_checks(study: Study) -> None:
    """Print what the checks say in words, where they were asked for."""
    asked = study.scene.checks
    if asked is None or study.checks is None:
        return
    loo = study.checks.loo
    print(f"Predictive density of the subjects left out: {loo.elpd:.1f} ± {loo.se:.1f} nats.")
    for message in loo.messages or ("No subject is influential or an outlier.",):
        print(message)
    looked_at = study.checks.sensitivity
    for row in looked_at[looked_at["diagnosis"] != ""].itertuples():
        print(f"{row.environment} {row.parameter}, {row.quantity}: {row.diagnosis} ({row.prior:.2f}).")
    if asked.compare and len(study.environments) > 1:
        print(study.model_choice.table.to_string(index=False, float_format="{:.1f}".format))
        print(study.model_choice.sentence)
