"""Figures as SVG without matplotlib: axes like its own, letters from a table, elements as text."""
