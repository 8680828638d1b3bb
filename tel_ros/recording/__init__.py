"""Files: configurations, arm descriptions, trial bags, networks and run folders. Runs without a ROS graph."""
