"""How often a bias is called smaller than one JND, or beyond it."""
