"""Figures: arrays to axes, records to drawings, and drawings to files and to the page."""
