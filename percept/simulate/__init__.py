"""Simulated studies: from the hierarchical model, and like a published table of limits.

Nothing here is measured, and every table made here says so in its column `source`.
"""
