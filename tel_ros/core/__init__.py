"""The method itself: arrays in, arrays out. No ROS, no files, no clock, no logger."""
