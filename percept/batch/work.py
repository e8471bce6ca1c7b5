"""What a worker does with one study."""

from __future__ import annotations

import tempfile
import time
from pathlib import Path
from typing import Any

from percept.batch.inputs import StudyFiles
from percept.batch.rows import Outcome, Status, to_parquet
from percept.errors import PerceptError, RefusalError
from percept.scene import Scene
from percept.sessions import ReadOptions, read_sessions
from percept.study import Study


def analyse(files: StudyFiles) -> Outcome:
    """Fit a study and encode its intervals."""
    started = time.perf_counter()
    status: Status
    intervals, shared = None, dict[str, Any]()
    try:
        study = _study(files)
        intervals, shared = study.intervals, _found(study)
        status, message = "done", None
        if study.fit is not None:
            gate = study.fit.run.gate
            status = "done" if gate.passed else "withheld"
            message = " ".join(gate.reasons) or gate.error_reached or None
    except PerceptError as error:
        status, message = "refused", str(error)
    except Exception as error:  # noqa: BLE001 - whatever it is, it is this study's and goes into its row
        status, message = "failed", f"{type(error).__name__}: {error}"
    shared |= {"study": files.name, "key": files.key, "status": status, "message": message}
    return Outcome(status, message, to_parquet(shared, intervals), time.perf_counter() - started)


def nothing_read(name: str, key: str, message: str, *, status: Status) -> Outcome:
    """Return the outcome of a study no worker gave one of."""
    shared = {"study": name, "key": key, "status": status, "message": message}
    return Outcome(status, message, to_parquet(shared), 0.0)


def _study(files: StudyFiles) -> Study:
    """Read the files from a folder that is gone afterwards; messages name the paths the user gave."""
    scene = Scene.from_tables(files.scene)
    options = ReadOptions.from_mapping(
        {"columns": scene.columns, "sessions": scene.sessions, "environments": scene.environments}
    )
    with tempfile.TemporaryDirectory(prefix="percept-") as root:
        folder = Path(root) / "study"
        for name, data in files.files:
            path = folder / name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(data)
        try:
            study = Study(read_sessions(*(folder / name for name, _ in files.files), options=options), scene)
            # Here, where a message can still say the user's path for the folder's.
            _ = study.intervals
        except PerceptError as error:
            raise RefusalError(str(error).replace(f"{folder}/", files.root)) from error
    return study


def _found(study: Study) -> dict[str, Any]:
    found: dict[str, Any] = {"subjects": len(study.sessions.subjects)}
    if study.fit is not None:
        gate = study.fit.run.gate
        found |= {
            "steps": study.fit.run.steps,
            "worst_error": gate.worst_error,
            "rhat": gate.rhat,
            "effective_draws": gate.effective_draws,
        }
    return found
