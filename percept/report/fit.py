"""Write the intervals and the posterior of a study, without a page."""

from __future__ import annotations

import shutil
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING

from percept.errors import UsageError
from percept.report.document import build_document
from percept.report.plain import dumps

if TYPE_CHECKING:
    from percept.study import Study

__all__ = ["write_fit"]


def write_fit(study: Study, out_dir: str | Path) -> Path:
    """Write fit.json, in report.json's schema without curves, and posterior.nc.

    Parameters
    ----------
    study : Study
        What it has not computed yet is computed now.
    out_dir : str or Path
        Folder, made where it does not exist; files of other names in it stay.

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
    out = Path(out_dir)
    if out.exists() and not out.is_dir():
        raise UsageError("the fit needs a folder, and this is a file.", file=str(out_dir))
    text = dumps(build_document(study, curves=False))
    posterior = study.posterior
    try:
        out.mkdir(parents=True, exist_ok=True)
        aside = Path(tempfile.mkdtemp(prefix=".fit-", dir=out))
    except OSError as error:
        raise UsageError(f"cannot be written: {error.strerror}.", file=str(out_dir)) from error
    try:
        if posterior is not None:
            posterior.to_netcdf(aside / "posterior.nc")
            (aside / "posterior.nc").replace(out / "posterior.nc")
        (aside / "fit.json").write_text(text, encoding="utf-8")
        (aside / "fit.json").replace(out / "fit.json")
    except OSError as error:
        raise UsageError(f"cannot be written: {error.strerror}.", file=str(out_dir)) from error
    finally:
        shutil.rmtree(aside, ignore_errors=True)
    return out / "fit.json"
