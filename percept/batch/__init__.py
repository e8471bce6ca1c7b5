"""Many studies on dask.distributed: one set of rows per study, resumable, one bad study never fatal."""

from percept.batch.cluster import connected
from percept.batch.folder import BatchFolder
from percept.batch.inputs import StudySource, sources
from percept.batch.run import Summary, run_batch

__all__ = ["BatchFolder", "StudySource", "Summary", "connected", "run_batch", "sources"]
