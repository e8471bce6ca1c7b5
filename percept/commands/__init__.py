"""Commands of the command line: one module each, with EXAMPLE, add_arguments and run."""
