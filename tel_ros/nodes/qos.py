"""Quality of service of the topics. Publishers are reliable, as those of stock ros2_control are."""

from __future__ import annotations

from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy


def _reliable(depth: int) -> QoSProfile:
    return QoSProfile(reliability=ReliabilityPolicy.RELIABLE, history=HistoryPolicy.KEEP_LAST, depth=depth)


STREAM = _reliable(10_000)
"""For publishers: a recorder that had to wait for its turn can still ask for what it has missed."""
NEWEST = QoSProfile(reliability=ReliabilityPolicy.BEST_EFFORT, history=HistoryPolicy.KEEP_LAST, depth=1)
"""For control: only the newest message counts; an older one is not worth being sent again."""
LATCHED = QoSProfile(
    reliability=ReliabilityPolicy.RELIABLE,
    durability=DurabilityPolicy.TRANSIENT_LOCAL,
    history=HistoryPolicy.KEEP_LAST,
    depth=1,
)
"""For a state of affairs: who comes late gets the newest value."""
EVERYTHING = _reliable(20_000)
"""For recording: a backlog of several seconds is worked off instead of dropped."""
EVENTS = _reliable(10)
"""For what happens now and then."""
