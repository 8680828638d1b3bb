"""Learned inverse dynamics and the signals it learns from."""
