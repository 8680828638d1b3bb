"""Who is on the arm's topics, and which joints the arm has."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from tel_ros.core.check.findings import Finding, Verdict, judged

Endpoint = tuple[str, str, str]
"""Node, type and reliability of a publisher or subscription."""
STATE_TYPE = "sensor_msgs/msg/JointState"
COMMAND_TYPE = "std_msgs/msg/Float64MultiArray"


def judge_connections(
    states: Sequence[Endpoint], commanders: Sequence[Endpoint], listeners: Sequence[Endpoint]
) -> list[Finding]:
    """Judge publishers of states, and publishers and subscriptions of commands, the check's own left out."""
    findings = [
        judged(
            "publisher of states",
            len(states) == 1 and states[0][1] == STATE_TYPE,
            _listed(states),
            f"one, of {STATE_TYPE}",
            "end all but one: states of two arms, or of an old process, would be mixed",
            blocks=True,
        ),
        judged(
            "other commands",
            not commanders,
            _listed(commanders),
            "nobody else commands the arm",
            "end whoever else commands the arm (tel practice, an old ep_controller, arm_guard) first",
            blocks=True,
        ),
        judged(
            "listener to commands",
            len(listeners) == 1 and listeners[0][1] == COMMAND_TYPE,
            _listed(listeners),
            f"one, of {COMMAND_TYPE}",
            "start and activate the controller that takes the commands; end a second one",
            blocks=True,
        ),
    ]
    unreliable = [name for name, _, reliability in states if reliability == "best_effort"]
    findings.append(
        judged(
            "quality of service",
            not unreliable,
            f"best effort: {', '.join(unreliable)}" if unreliable else "reliable",
            "states are published reliably",
            "the recorder asks for reliable delivery and would hear nothing",
        )
    )
    return findings


def judge_names(names: Iterable[tuple[str, ...]], joints: Sequence[str], malformed: int) -> list[Finding]:
    """Judge the names in the joint states.

    Args:
        names: lists of names that have come; each message has one.
        joints: of the arm.
        malformed: number of messages whose fields do not fit together.
    """
    heard = sorted(set(names))
    findings = []
    for joint in joints:
        counts = sorted({each.count(joint) for each in heard})
        others = sorted({name for each in heard for name in each} - set(joints))
        measured = {(1,): "in every message", (0,): "in none", (0, 1): "not in every message"}
        findings.append(
            judged(
                "name",
                counts == [1],
                measured.get(tuple(counts), "more than once in a message")
                + (f" (others: {', '.join(others)})" if counts == [0] and others else ""),
                "once in every message",
                "arm.joints needs the names of the joint states; one broadcaster for all joints of the arm",
                joint=joint,
                blocks=True,
            )
        )
    if malformed:
        text = f"{malformed} messages have fields of different lengths"
        expected = "as many positions (velocities, efforts) as names"
        mend = "mend the publisher of the joint states"
        findings.append(Finding("fields", Verdict.WRONG, text, expected, mend, blocks=True))
    return findings


def _listed(endpoints: Sequence[Endpoint]) -> str:
    return ", ".join(f"{node} ({kind})" for node, kind, _ in endpoints) or "none"
