"""The paper reproduced from its published numbers."""
