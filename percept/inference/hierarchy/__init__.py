"""The hierarchical model of adjusted stiffness and damping, collapsed to its scales and correlations."""
