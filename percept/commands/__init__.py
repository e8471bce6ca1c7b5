"""Commands of the command line: one module each, with HELP, EXAMPLE, add_arguments and run."""
