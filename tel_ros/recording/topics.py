"""Names of the topics, services and actions, and the types of what is recorded.

All but two are relative: a node's namespace and remapping rules apply to them, so that two arms can practise
side by side. A bag holds them with the namespace in front (:func:`absolute`).
"""

from tel_ros.core.config import ArmConfig

JOINT_STATES = "joint_states"
"""sensor_msgs/JointState, as stock ``joint_state_broadcaster`` publishes it."""
EFFORT_COMMANDS = "effort_controller/commands"
"""std_msgs/Float64MultiArray, as a stock ``JointGroupEffortController`` takes it."""
EP_CONTROLLER = "ep_controller"
"""Name of the managed node that commands the arm."""
ARM_GUARD = "arm_guard"
"""Name of the node that commands it in its place."""
POSITION_COMMANDS = "position_controller/commands"
"""std_msgs/Float64MultiArray, as a stock ``ForwardCommandController`` of positions takes it."""
COMMANDS = {"effort": EFFORT_COMMANDS, "position": POSITION_COMMANDS}
"""``arm.command_interface`` to topic, where every state has a command of its own."""
JOINT_TRAJECTORY_COMMANDS = "joint_trajectory"
"""trajectory_msgs/JointTrajectory, below a ``joint_trajectory_controller``: goals that nobody answers for."""
FOLLOW_JOINT_TRAJECTORY = "follow_joint_trajectory"
"""control_msgs/FollowJointTrajectory, an action: goals that it answers for."""
CONTROLLER_STATE = "controller_state"
"""control_msgs/JointTrajectoryControllerState: what it wants, sees and commands."""
PASSED = "ep_controller/passed"
"""builtin_interfaces/Time: the newest state that was dealt with, for a simulation that waits for it."""
CONTROL_STATES = "ep_controller/state"
READY = "ep_controller/ready"
"""std_msgs/Bool, latched: the controller is active, joint states arrive, somebody listens to its commands."""

SAFETY_STOP = "safety/stop"
"""std_srvs/Trigger: the trial under way is aborted, the arm braked; nothing starts before the reset."""
SAFETY_RESET = "safety/reset"
"""std_srvs/Trigger: refused while the arm moves."""
SAFETY_STOPPED = "safety/stopped"
"""std_msgs/Bool, latched: whether an emergency stop waits for its reset."""
ROBOT_DESCRIPTION = "robot_description"
"""std_msgs/String, latched: the URDF, where the configuration names no file."""
CLOCK = "/clock"
"""rosgraph_msgs/Clock, global: the time of a replay, for nodes with ``use_sim_time``."""
DIAGNOSTICS = "/diagnostics"
"""diagnostic_msgs/DiagnosticArray, global as everywhere in ROS: the status names carry the namespace."""

TRIAL_GOAL = "practice/trial_goal"
"""tel_interfaces/TrialGoal, latched: what the trial under way was asked to do; in a bag, what it was."""
TRIAL_RESULT = "practice/trial_result"

PAUSE = "practice/pause"
"""std_srvs/SetBool: whether the run waits before its next trial; the one under way goes on to its end."""
PAUSED = "practice/paused"
"""std_msgs/Bool, latched: what has been asked for last."""

EXECUTE_TRIAL = "execute_trial"
PRACTICE = "practice"
PREDICT = "inverse_dynamics/predict"
TRAIN = "inverse_dynamics/train"
SAVE = "inverse_dynamics/save"
LOAD = "inverse_dynamics/load"
START_RECORDING = "trial_recorder/start"
STOP_RECORDING = "trial_recorder/stop"

JOINT_STATE = "sensor_msgs/msg/JointState"
JOINT_TRAJECTORY = "trajectory_msgs/msg/JointTrajectory"
RECORDED_LIVE = {
    JOINT_STATES: JOINT_STATE,
    CONTROL_STATES: "tel_interfaces/msg/ControlState",
}
"""Taken from the graph while a trial runs: topic to type."""

RECORDED_COMMANDS = dict.fromkeys(COMMANDS.values(), "std_msgs/msg/Float64MultiArray")
"""Likewise; a trial has one of them, or none where a controller follows trajectories."""

RECORDED_ONCE = {
    TRIAL_GOAL: "tel_interfaces/msg/TrialGoal",
    TRIAL_RESULT: "tel_interfaces/msg/TrialResult",
}
"""Written into each bag once, at its beginning or end: topic to type."""


def commands(arm: ArmConfig) -> str:
    """Return the topic on which an arm takes commands: efforts, set points or trajectories."""
    if arm.command_interface == "trajectory":
        return f"{arm.trajectory_controller}/{JOINT_TRAJECTORY_COMMANDS}"
    return COMMANDS[arm.command_interface]


def private(topic: str) -> str:
    """Return the private name of a topic or service, for the node that owns it: it follows a renamed node."""
    return f"~/{topic.partition('/')[2]}"


def absolute(topic: str, namespace: str = "/") -> str:
    """Return the full name of a topic in a namespace, whatever it is remapped to: its name in a bag."""
    return f"{namespace.rstrip('/')}/{topic}"


def is_named(name: str, topic: str) -> bool:
    """Return whether a full name is that of a topic, in whatever namespace."""
    return name.endswith(f"/{topic}")
