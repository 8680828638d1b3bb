"""How the topics of a trial are offered: what a bag tells those who play it."""

from __future__ import annotations

from rosbags.interfaces import Qos, QosDurability, QosHistory, QosLiveliness, QosReliability, QosTime

from tel_ros.recording import topics

_DEPTH = 10
_INFINITE = QosTime(9223372036, 854775807)
"""The longest time that rosbag2 can tell: no deadline, no lifespan, no lease."""


def offered_qos(topic: str, *, latched: bool = False) -> Qos:
    """Return the quality of service for playing a topic of a trial.

    Reliable, as it was published. What a trial has once is for whoever comes late as well.

    Args:
        topic: its name.
        latched: whether that holds for this one, too.
    """
    once = latched or any(topics.is_named(topic, name) for name in topics.RECORDED_ONCE)
    return Qos(
        history=QosHistory.KEEP_LAST,
        depth=1 if once else _DEPTH,
        reliability=QosReliability.RELIABLE,
        durability=QosDurability.TRANSIENT_LOCAL if once else QosDurability.VOLATILE,
        deadline=_INFINITE,
        lifespan=_INFINITE,
        liveliness=QosLiveliness.AUTOMATIC,
        liveliness_lease_duration=_INFINITE,
        avoid_ros_namespace_conventions=False,
    )
