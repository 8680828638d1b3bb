"""Paths, time scaling and sampling: from a shape to a desired trajectory."""
