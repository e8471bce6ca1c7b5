"""Write the intervals and the posterior of a study, without a page."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from percept.files import filled_folder
from percept.report.document import build_document
from percept.report.plain import dumps

if TYPE_CHECKING:
    from percept.study import Study


def write_fit(study: Study, out_dir: str | Path) -> Path:
    """Write fit.json, in report.json's schema without curves, and posterior.nc.

    Parameters
    ----------
    study : Study
        What it has not computed yet is computed now.
    out_dir : str or Path
        Folder, made where it does not exist; files of other programs in it stay.

    Returns
    -------
    Path
        ``out_dir/fit.json``.

    Raises
    ------
    UsageError
        Where `out_dir` is a file or cannot be written.
    PerceptError
        What the study refuses.
    """
    from percept.study.posterior_file import write_posterior

    with filled_folder(out_dir, last="fit.json") as folder:
        (folder / "fit.json").write_text(dumps(build_document(study, curves=False)), encoding="utf-8")
        if study.posterior_groups is not None:
            write_posterior(study.posterior_groups, folder / "posterior.nc")
    return Path(out_dir) / "fit.json"
