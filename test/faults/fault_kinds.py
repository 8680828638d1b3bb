"""The kinds of faults as a list: what each does, how often, and what is right after it. Add a kind here."""

from __future__ import annotations

import math
import signal
from collections.abc import Sequence
from functools import partial
from typing import TYPE_CHECKING, Any

import fault_messages as m
from fault_judge import Expectation
from fault_kind import GUARDED, IN_BETWEEN, Act, Kind
from fault_setups import COMMAND_AGE_LIMIT_S, SETUPS, WATCHDOG_S
from std_msgs.msg import Float64MultiArray

from tel_ros.app.bring_up import MODULES

if TYPE_CHECKING:
    from fault_graph import FaultGraph

FOLLOWED = ("trajectory",)
"""Where the loop is the arm's own: without ep_controller it goes on to the end of its goal."""
LOCKSTEP = tuple(name for name, setup in SETUPS.items() if not (setup.in_between or name in FOLLOWED))
LOOP = (*IN_BETWEEN, *LOCKSTEP)
EVERYWHERE = (*LOOP, *FOLLOWED)
WHERE = {"arm_guard": GUARDED}  # an arm in lockstep waits for commands and needs no guard
OUTSIDE_THE_LOOP = tuple(
    name for name in MODULES if name not in ("sim_bridge", "ep_controller", "feedforward_controller")
)
"""Nodes that a trial does not need once it has begun."""
STATES_LOST = (
    r"no (new )?joint state|joint states come|stamps of the joint states|off its desired|moves at|"
    r"is at |does not exert what it is commanded|are frozen"
)
ANY_REASON = STATES_LOST + r"|no effort command|not at rest"
FROZEN_RAD = 0.05
SILENCE_S = 0.1
"""The controller's time-out for states."""


def _by_length(parameters: m.Parameters) -> Expectation:
    """Shorter than the time-out it must not matter, longer it must stop the arm."""
    return "ride" if parameters["duration_s"] < 0.5 * SILENCE_S else "stop"


def _states_of_another_driver(graph: FaultGraph, values: m.Parameters) -> None:
    joints = graph.config.arm.joints
    graph.tap.intrude("states", lambda: graph.tap.resting_state(joints), values["duration_s"])


def _commands_of_another_controller(graph: FaultGraph, values: m.Parameters) -> None:
    message = Float64MultiArray(
        data=[values["share_of_limit"] * limit for limit in graph.config.arm.effort_limit_nm]
    )
    graph.tap.intrude("commands", lambda: message, values["duration_s"])


_WATCHDOG = f"The arm's own watchdog takes the effort away after {1e3 * WATCHDOG_S:.0f} ms; "
_BRAKES = "The controller brakes the arm, then its effort goes to zero."


def _state(name: str, what: str, draw: m.Draw, expects: Any, change: Any, right: str, **more: Any) -> Kind:
    more.setdefault("says", STATES_LOST)
    return Kind(f"state_{name}", what, right, draw, expects, change=change, **more)


def _unusable(name: str, what: str, change: Any) -> Kind:
    right = "A few are ignored; after 0.1 s without a usable one the trial is aborted with zero effort."
    return _state(name, what, m.draw_brief_or_long, _by_length, change, right)


def _command(name: str, what: str, draw: m.Draw, change: Any, right: str = "As NaN.") -> Kind:
    return Kind(f"command_{name}", what, right, draw, "either", ANY_REASON, change)


def _paused(node: str, right: str, expects: Expectation = "stop", **more: Any) -> Kind:
    def act(graph: FaultGraph, values: m.Parameters) -> None:
        graph.pause(node, values["pause_s"])

    more = {"name": f"pause_{node}", "what": "SIGSTOP for 0.2 to 1.5 s", **more}
    return Kind(
        right=right,
        draw=m.draw_evenly("pause_s", 0.2, 1.5),
        expects=expects,
        says=STATES_LOST,
        act=act,
        **more,
    )


def _ending(name: str, what: str, says: str, codes: Sequence[int], act: Act, right: str, **more: Any) -> Kind:
    """Return a fault that ends the run; unless ``expects`` differs, the trial may go on meanwhile."""
    more = {"expects": "end", "weight": 0.7, **more}
    return Kind(name, what, right, lambda rng: {}, says=says, act=act, codes=tuple(codes), **more)


def _sent(node: str, number: signal.Signals) -> Act:
    return lambda graph, values: graph.send(node, number)


def _killed(node: str, says: str = "", **more: Any) -> Kind:
    says = f"node {node} was killed by SIGKILL{says}"
    more = {"what": "SIGKILL", "right": f"The run ends: t{_BRAKES[1:]}", "codes": (3,), **more}
    return _ending(f"kill_{node}", says=says, act=_sent(node, signal.SIGKILL), **more)


def _hung(node: str, says: str, **more: Any) -> Kind:
    right = "The trial goes on; the run ends when it is noticed that the node does not answer."
    more = {"what": "SIGSTOP for good", "right": right, "setups": ("lockstep",), "weight": 0.2, **more}
    more = {"codes": (3,), "act": _sent(node, signal.SIGSTOP), **more}
    return _ending(f"hang_{node}", says=says, **more)


def _hung_then_interrupted(graph: FaultGraph, values: m.Parameters) -> None:
    graph.send("inverse_dynamics", signal.SIGSTOP)
    graph.later(10.0, lambda: graph.send("tel", signal.SIGINT))


_CALLED = ("somebody calls /safety/stop", "emergency stop", (1,), lambda graph, _: graph.tap.emergency_stop())
_DELAY = m.draw_evenly("delay_s", 0.01, 0.06, duration_s=1.0)
_JOINT_FIELDS = ("name", "position", "velocity", "effort")
_STATES = (
    _unusable("nan", "NaN as a position", partial(m.overwritten, "position", value=math.nan)),
    _unusable("inf", "infinite position", partial(m.overwritten, "position", value=math.inf)),
    _unusable("short", "one position too few", partial(m.shortened, ["position"])),
    _unusable("nameless", "a joint is missing", partial(m.shortened, _JOINT_FIELDS)),
    _state(
        *("huge", "a position or velocity of 1e2 to 1e12, in 1 or 3 messages"),
        *(m.draw_huge, "either", m.overwritten),
        "The trial is aborted, or the messages are ignored.",
    ),
    _state(
        *("reordered", "neighbouring messages change places, for 0.1 s"),
        *(m.draw_lasting(0.1), "either", m.reordered),
        "A state older than the last one is ignored.",
    ),
    _state(
        *("delayed", "all are 10 to 60 ms late, for 1 s", _DELAY, "either", m.delayed),
        "Springs and dampers bear some latency; if the arm begins to swing, the path tolerance ends it.",
    ),
    _state(
        "dropped", "20 to 60 % get lost, for 1 s", m.draw_drop, "ride", m.dropped, "The next is answered."
    ),
    _state(
        *("stutter", "one every 20 to 92 ms gets through, for 1 s", m.draw_stutter, "either", m.thinned),
        "No pause reaches a time-out, but an effort that is held so long no longer damps. The trial is "
        "completed, or aborted before the arm swings up.",
    ),
    _state(
        *("silence", "none for 1 s", m.draw_lasting(1.0), "stop", partial(m.dropped, 1.0)),
        "No state, no commands: the arm's watchdog and the controller both take the effort away.",
    ),
    _state(
        *("repeated", "the same message again and again, for 1 s", m.draw_lasting(1.0), "stop", m.repeated),
        "A stamp that does not move is no new state: as silence.",
        says=STATES_LOST + "|repeat their stamp",
    ),
    _state(
        *("frozen", "position, velocity or both stay as they are, of one joint or all; stamps go on"),
        *(m.draw_frozen, "stop", m.stood),
        "No brake: it would trust the same readings. The effort goes to zero, the run ends, and says which. "
        f"Counted from where a joint is {FROZEN_RAD} rad from where it is said to be.",
        **{"says": "are frozen", "codes": (1, 3), "window_s": (0.85, 2.0), "weight": 2.0},
    ),
    _state(
        *("wiring", "a joint with the other sign or in degrees, or two exchanged, from the start"),
        *(m.draw_wiring, "either", m.rewired),
        "A posture beyond the range is refused; otherwise the first approach ends without effort, before the "
        "arm is fast. No other trial follows.",
        says="moves away|swings from side|no brake is tried|outside of its range|has jumped|moves at|is at ",
        **{"codes": (1, 3), "window_s": None, "setups": ("planar", "planar_3", "unguarded"), "weight": 1.5},
    ),
    _state(
        *("time_back", "stamps jump back by 0.15 s to an hour; later forward again"),
        *(m.draw_jump(-1.0), "stop", m.shifted),
        "The trial is aborted and the arm braked: the state does not follow the last one.",
    ),
    _state(
        *("time_forward", "stamps jump forward by 0.15 s to an hour; later back again"),
        *(m.draw_jump(1.0), "stop", m.shifted, "As back."),
    ),
    Kind(
        *("state_duplicate", "a second publisher says the arm rests at zero, for 1 s"),
        "The trial is aborted: positions jump, or stamps do not grow. Counted from its first message.",
        *(m.draw_lasting(1.0), "stop", STATES_LOST + "|publish"),
        act=_states_of_another_driver,
    ),
)
_COMMANDS = (
    _command(
        *("nan", "NaN as an effort", m.draw_brief_or_long, partial(m.overwritten, "data", value=math.nan)),
        "The arm does not apply it. It may coast meanwhile; the trial goes on, leaves the path tolerance, or "
        "is aborted because the motors do not act.",
    ),
    _command("inf", "infinite effort", m.draw_brief_or_long, partial(m.overwritten, "data", value=math.inf)),
    _command("short", "one effort too few", m.draw_brief_or_long, partial(m.shortened, ["data"])),
    _command(
        *("huge", "1e3 to 1e12 N·m in 1 to 5 messages", m.draw_huge_effort, partial(m.overwritten, "data")),
        "The arm clips it to its limit: a kick that the springs take up.",
    ),
    _command(
        *("reordered", "neighbouring messages change places, for 0.1 s", m.draw_lasting(0.1), m.reordered),
        "The effort is one period old now and then, which does no harm.",
    ),
    _command(
        *("delayed", "all are 10 to 60 ms late, for 1 s", _DELAY, m.delayed),
        f"The driver refuses answers to states older than {1e3 * COMMAND_AGE_LIMIT_S:.0f} ms: as silence.",
    ),
    _command(
        "stutter", "one every 20 to 92 ms gets through, for 1 s", m.draw_stutter, m.thinned, "As states."
    ),
    _command(
        *("silence", "none reaches the arm for 1 s", m.draw_lasting(1.0), partial(m.dropped, 1.0)),
        _WATCHDOG + "when commands return, the trial goes on within the path tolerance or has been aborted.",
    ),
    _command(
        *(
            "limited",
            "the drives give 0.5 to 2 N·m at most, for 4 s",
            m.draw_evenly("most_nm", 0.5, 2.0, 2, duration_s=4.0),
            m.limited,
        ),
        "Said, and not learned from; the trial is completed, or leaves the path tolerance.",
    ),
    Kind(
        *("command_duplicate", "a second publisher commands up to 20 % of the limit, for 1 s"),
        "Competing publishers are never right: the trial is aborted. What the second one sends still reaches "
        "the drive, so the arm is judged from its last message on.",
        *(
            m.draw_evenly("share_of_limit", -0.2, 0.2, duration_s=1.0),
            "stop",
            ANY_REASON + "|commands the arm",
        ),
        act=_commands_of_another_controller,
    ),
)
_PAUSES = (
    _paused("ep_controller", _WATCHDOG + "then the controller finds that time has passed, and brakes."),
    _paused(
        *("ep_controller", "The arm's time stands still, for 1 s at most; then it coasts.", "either"),
        name="pause_in_lockstep",
        what="ep_controller gets SIGSTOP for 0.2 to 1.5 s",
        setups=LOCKSTEP,
    ),
    _paused(
        "sim_bridge",
        "As silence of the states; the driver's motors do what they did until it runs again.",
        what="SIGSTOP for 0.2 to 1.5 s: the driver stands still",
    ),
    *(
        _paused(
            node,
            "Outside the control loop: the trial goes on.",
            "ride",
            setups=WHERE.get(node, EVERYWHERE),
            weight=0.5,
        )
        for node in (*OUTSIDE_THE_LOOP, "tel")
    ),
)
_ENDINGS = (
    _killed(
        "ep_controller",
        right=_WATCHDOG + "the run ends and says which node died.",
        expects="stop",
        setups=LOOP,
        weight=1.0,
    ),
    *(_killed(node, setups=WHERE.get(node, EVERYWHERE)) for node in OUTSIDE_THE_LOOP),
    _killed(
        *("sim_bridge", "|no joint state|the arm is not there"),
        what="SIGKILL: the driver of the arm is gone",
        right="What the motors do then is up to the drive. The last command that anybody sends is zero.",
        setups=("planar", *LOCKSTEP),
    ),
    _ending(
        *("kill_tel", "SIGKILL to `tel practice` itself", "CANCELLED|completed", (-9,)),
        _sent("tel", signal.SIGKILL),
        "The kernel ends the nodes, and the controller brakes first; only its log can say so.",
        setups=EVERYWHERE,
    ),
    _ending(
        *("interrupt", "SIGINT to `tel practice`", "interrupted", (130,)),
        *(_sent("tel", signal.SIGINT), _BRAKES),
        setups=EVERYWHERE,
    ),
    _ending(
        *("emergency_stop", *_CALLED, "The arm is braked and released; the run ends and says why."),
        expects="stop",
    ),
    _ending(
        *("emergency_stop_in_lockstep", *_CALLED),
        "As in real time, once the controller has seen the call: the arm's time may go on until then.",
        setups=(*LOCKSTEP, *FOLLOWED),
        weight=0.3,
    ),
    _hung(
        *("ep_controller", "execute_trial was silent"),
        right=_WATCHDOG + "the run ends because the controller does not answer.",
        expects="stop",
        setups=("planar", *LOCKSTEP),
        weight=0.3,
    ),
    _hung("trial_recorder", "trial_recorder"),
    _hung("practice_manager", "practice_manager|practice manager"),
    _hung(
        *("inverse_dynamics", "interrupted"),
        what="SIGSTOP for good, and Ctrl-C 10 s later",
        right="Learning may take minutes: the run waits for 600 s, and the arm is held. Ctrl-C ends the run.",
        codes=(130,),
        act=_hung_then_interrupted,
    ),
    _ending(
        *("disk_full", "the disk with the run's folder has no free block any more (ENOSPC)"),
        *("No space left on device|room on the disk", (1, 3), lambda graph, values: graph.fill_disk()),
        "The trial may end; its bag stays unfinished, the run ends and says so.",
        setups=EVERYWHERE,
        weight=1.0,
    ),
    _ending(
        *("recorder_file_limit", "no file of trial_recorder can grow any more (EFBIG)"),
        *("File too large|room on the disk", (1, 3)),
        lambda graph, values: graph.limit_files("trial_recorder"),
        "As a full disk, for the recorder alone.",
        setups=("planar", *LOCKSTEP),
    ),
)
KINDS = {kind.name: kind for kind in (*_STATES, *_COMMANDS, *_PAUSES, *_ENDINGS)}
