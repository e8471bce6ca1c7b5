"""Simulation-based calibration: truths of the prior lie evenly in their posteriors."""
