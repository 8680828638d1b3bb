"""A practice run as one file for other programs."""
