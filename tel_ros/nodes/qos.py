"""Quality of service of the topics. Publishers are reliable, as those of stock ros2_control are."""

from __future__ import annotations

from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy

FASTEST_HZ = 2_500
"""Messages of a topic per second in lockstep, where time goes as fast as the nodes answer each other."""
LONGEST_PAUSE_S = 2.0
"""How long a recorder may stand still (stopped, starved, waiting for its disk) without losing a message."""
_BACKLOG = round(FASTEST_HZ * LONGEST_PAUSE_S)


def _reliable(depth: int) -> QoSProfile:
    return QoSProfile(reliability=ReliabilityPolicy.RELIABLE, history=HistoryPolicy.KEEP_LAST, depth=depth)


STREAM = _reliable(_BACKLOG)
"""For publishers: a recorder that stood still asks for what it has missed."""
NEWEST = QoSProfile(reliability=ReliabilityPolicy.BEST_EFFORT, history=HistoryPolicy.KEEP_LAST, depth=1)
"""For control: only the newest message counts; an older one is not worth being sent again."""
LATCHED = QoSProfile(
    reliability=ReliabilityPolicy.RELIABLE,
    durability=DurabilityPolicy.TRANSIENT_LOCAL,
    history=HistoryPolicy.KEEP_LAST,
    depth=1,
)
"""For a state of affairs: who comes late gets the newest value."""
EVERYTHING = _reliable(2 * _BACKLOG)
"""For recording: what was missed comes all at once, and the stream goes on meanwhile."""
EVENTS = _reliable(10)
"""For what happens now and then."""

STATES_AHEAD = 32
"""How far a simulation that waits goes beyond the newest state that its client says to have dealt with."""
