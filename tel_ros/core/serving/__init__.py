"""Trajectories of others, executed with what has been learned: learning in service."""
