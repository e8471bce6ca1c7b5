"""percept on the command line: `python -m percept`."""
