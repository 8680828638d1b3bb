"""``tel bag``: what bags hold, figures of them, their export to other programs, and what a crash left."""
