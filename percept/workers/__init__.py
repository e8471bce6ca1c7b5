"""Many jobs on one process or many: the same answers whoever works on them, a bad job never fatal."""

from percept.workers.cluster import connected, open_mapper
from percept.workers.jobs import Answer, InProcess, Job, Mapper
from percept.workers.on_cluster import OnCluster

__all__ = ["Answer", "InProcess", "Job", "Mapper", "OnCluster", "connected", "open_mapper"]
