"""What stands between a wanted effort and the motors, and what ends a trial: pure, without ROS."""
