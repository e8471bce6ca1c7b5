"""percept against general samplers: run time, error, effective draws, whole commands."""
