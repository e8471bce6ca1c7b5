"""One module per command of the command line.

Each has `EXAMPLE`, a line of its help; `add_arguments`, which takes the command's parser; and `run`, which
takes the parsed arguments, prints, and returns the exit code. Slow imports stand inside `run`.
"""
