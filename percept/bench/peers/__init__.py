"""percept against general samplers on one study: run time, error, effective draws, whole commands."""
