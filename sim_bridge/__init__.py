"""The hardware stand-in: a simulated arm that keeps the promises of a real one.

May import :mod:`tel_ros.core` and, in its node, topic names, conversions and QoS. Nothing in ``core``,
``recording`` or ``nodes`` imports it: to them it is just an arm.
"""
