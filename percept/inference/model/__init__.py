"""The hierarchical model of adjusted quantities, collapsed to its scales and correlations."""
