"""The paper reproduced from its published numbers: every table, figure and claim."""
