"""Checks of a hierarchical fit against its own data: what each subject says of the model."""

__all__ = ()
