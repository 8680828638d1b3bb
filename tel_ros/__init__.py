"""Trajectory Extension Learning: robot arms that get better at a movement by practice."""

__version__ = "0.1.0"
