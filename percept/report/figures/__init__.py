"""Figures: each draws plain arrays on axes it is given."""
