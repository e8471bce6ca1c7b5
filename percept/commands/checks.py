"""Flags that ask a fit or a report for checks of the hierarchical model."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from percept.scene import Scene

__all__ = ["add_check_arguments", "with_checks"]


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
    """Return the scene with what the flags ask for beside what it asks for itself.

    Parameters
    ----------
    scene : Scene
        As it was loaded.
    arguments : argparse.Namespace
        Of a command with or without the flags.

    Returns
    -------
    Scene
    """
    flags = {name: bool(vars(arguments).get(name)) for name in ("checks", "refit", "models")}
    if not any(flags.values()):
        return scene
    tables = scene.model_dump(exclude_none=True)
    asked = tables.get("checks", {})
    tables["checks"] = {
        "refit": flags["refit"] or asked.get("refit", False),
        "compare": flags["models"] or asked.get("compare", False),
    }
    return type(scene).from_tables(tables)
