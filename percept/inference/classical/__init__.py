"""Classical intervals: what a sample says about the mean, the next user and a share of all users."""
