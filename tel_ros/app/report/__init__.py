"""The report of one practice run, or of several side by side: a page that needs nothing beside it."""
