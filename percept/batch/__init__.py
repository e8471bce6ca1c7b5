"""Many studies on whatever workers there are: one set of rows each, resumable, a bad one never fatal."""

from percept.batch.folder import BatchFolder
from percept.batch.inputs import StudySource, sources
from percept.batch.run import Summary, run_batch

__all__ = ["BatchFolder", "StudySource", "Summary", "run_batch", "sources"]
