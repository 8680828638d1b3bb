"""Recordings that other programs made: bags of any ROS, and CSV."""
