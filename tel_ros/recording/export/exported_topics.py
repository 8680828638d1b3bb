"""Topics of an exported file that no bag holds, and what is on them."""

ROBOT_DESCRIPTION = "/robot_description"
"""std_msgs/String, once: the URDF as it was recorded."""
TF = "/tf"
"""tf2_msgs/TFMessage: the links behind joints that move."""
TF_STATIC = "/tf_static"
"""tf2_msgs/TFMessage, once: all other links."""

_OURS = "/export"
DESIRED_PATH = f"{_OURS}/hand_path/desired"
"""nav_msgs/Path, once a trial, at its beginning: of the hand in RUN; empty if RUN was not reached."""
ACTUAL_PATH = f"{_OURS}/hand_path/actual"
EQUILIBRIUM_PATH = f"{_OURS}/hand_path/equilibrium"
ERROR = f"{_OURS}/error_rad"
"""std_msgs/Float64MultiArray, every tick of RUN: measured minus desired position of each joint."""
EFFORT_LIMIT = f"{_OURS}/effort_limit_nm"
"""std_msgs/Float64MultiArray at both ends of a trial: the limit of each joint, then its negative for each."""

ONCE_A_FILE = {ROBOT_DESCRIPTION: "std_msgs/msg/String", TF_STATIC: "tf2_msgs/msg/TFMessage"}
"""Topic to type."""
ONCE_A_TRIAL = dict.fromkeys((DESIRED_PATH, ACTUAL_PATH, EQUILIBRIUM_PATH), "nav_msgs/msg/Path")
"""Likewise."""
STREAMED = {
    TF: "tf2_msgs/msg/TFMessage",
    ERROR: "std_msgs/msg/Float64MultiArray",
    EFFORT_LIMIT: "std_msgs/msg/Float64MultiArray",
}
"""Likewise."""
ADDED = {**ONCE_A_FILE, **ONCE_A_TRIAL, **STREAMED}
"""Likewise: all of them."""
