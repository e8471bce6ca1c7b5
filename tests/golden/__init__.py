"""Numbers of eight studies, frozen before changes that must not move them."""
