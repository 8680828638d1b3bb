"""Torque as a function of motion, from recordings of arms that were not made by practice."""
