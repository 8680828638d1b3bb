"""The node that executes trajectories of others, and what it needs of the graph."""
