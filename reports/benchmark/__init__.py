"""Run time against error, on the machine at hand."""
