"""The psychophysics table, and whether biases are smaller than one JND; by both methods."""
