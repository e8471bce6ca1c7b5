"""The commands of the command line: a module for each, and what they share.

A command has `EXAMPLE`, a line of its help; `add_arguments`, which takes the command's parser; and `run`,
which takes the parsed arguments, prints, and returns the exit code. Slow imports stand inside `run`.
What they share is in `analysis`.
"""
