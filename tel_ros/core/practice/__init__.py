"""Practice strategies: which trajectory to try next."""
