"""Equilibrium-point control and the course of one trial: state in, effort out."""
