"""Trials for an arm behind a joint_trajectory_controller."""
