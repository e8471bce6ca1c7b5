"""What a sample says of the mean, the next user and a share of all users."""

__all__ = ()
