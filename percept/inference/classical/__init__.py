"""Classical inference on the average user, the next one and a share of all users."""
