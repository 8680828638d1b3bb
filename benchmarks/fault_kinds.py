"""Kinds of faults, and what is right after each of them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from fault_setups import COMMAND_AGE_LIMIT_S, RATE_HZ, WATCHDOG_S

from tel_ros.app.bring_up import MODULES

Expectation = Literal["stop", "ride", "either", "end"]
EXPECTATIONS: dict[Expectation, str] = {
    "stop": "the arm is braked, held or without effort within 0.1 s of arm time, until the next trial begins",
    "ride": "the trial goes on and is completed",
    "either": "the trial is completed, or braked: then as soon as the controller says STOP",
    "end": "the loop of arm and controller is whole, so the trial may go on while the run is being ended; "
    "the "
    "arm is braked as soon as the controller says STOP",
}
IN_BETWEEN = ("planar", "planar_3", "iiwa")
LOCKSTEP = ("lockstep", "iiwa_lockstep")
EVERYWHERE = (*IN_BETWEEN, *LOCKSTEP)
OUTSIDE_THE_LOOP = tuple(name for name in MODULES if name not in ("sim_bridge", "ep_controller"))
"""Nodes that a trial, once begun, does not need."""


def _where(node: str) -> tuple[str, ...]:
    """Return the graphs that have a node: an arm in lockstep waits for commands and needs no guard."""
    return IN_BETWEEN if node == "arm_guard" else EVERYWHERE


STATES_LOST = (
    r"no joint state|no joint states|joint states come|stamps of the joint states|off its desired|moves at|"
    r"is at |does not exert what it is commanded"
)
ANY_REASON = STATES_LOST + r"|no effort command|not at rest"
SILENCE_S = 0.1
_PERIOD_S = 1.0 / RATE_HZ

Parameters = dict[str, Any]


@dataclass(frozen=True)
class Kind:
    """One kind of fault.

    Args:
        name: as in results.
        channel: what is disturbed: ``states``, ``commands``, ``process`` or ``disk``.
        what: what is done, for the page.
        right: what is right then, and why, for the page.
        draw: makes the parameters of one fault.
        expects: what is right for these parameters.
        says: what has to be said, as a regular expression, if the trial is not completed.
        setups: names of the graphs that it is injected into.
        ends_run: whether the run is over then.
        codes: with what ``tel practice`` may exit then.
        weight: how often it is drawn.
        interrupt_after_s: when somebody presses Ctrl-C (wall clock); None: nobody does.
    """

    name: str
    channel: Literal["states", "commands", "process", "disk"]
    what: str
    right: str
    draw: Callable[[np.random.Generator], Parameters]
    expects: Callable[[Parameters], Expectation]
    says: str
    setups: tuple[str, ...] = IN_BETWEEN
    ends_run: bool = False
    codes: tuple[int, ...] = ()
    weight: float = 1.0
    interrupt_after_s: float | None = None


def _nothing(rng: np.random.Generator) -> Parameters:
    return {}


def _brief_or_long(rng: np.random.Generator) -> Parameters:
    """One message, some, or a second of them."""
    duration_s = float(rng.choice([_PERIOD_S, 5 * _PERIOD_S, 0.5, 1.0]))
    return {"duration_s": duration_s, "joint": int(rng.integers(2))}


def _one_second(rng: np.random.Generator) -> Parameters:
    return {"duration_s": 1.0}


def _huge(rng: np.random.Generator) -> Parameters:
    field_name = str(rng.choice(["position", "velocity"]))
    return {
        **{"duration_s": float(rng.choice([1, 3])) * _PERIOD_S, "joint": int(rng.integers(2))},
        **{"field": field_name, "value": float(rng.choice([-1.0, 1.0]) * 10.0 ** rng.uniform(2.0, 12.0))},
    }


def _huge_effort(rng: np.random.Generator) -> Parameters:
    value = float(rng.choice([-1.0, 1.0]) * 10.0 ** rng.uniform(3.0, 12.0))
    return {
        "duration_s": float(rng.integers(1, 6)) * _PERIOD_S,
        "joint": int(rng.integers(2)),
        "value": value,
    }


def _delay(rng: np.random.Generator) -> Parameters:
    return {"duration_s": 1.0, "delay_s": round(float(rng.uniform(0.01, 0.06)), 3)}


def _jump(sign: float) -> Callable[[np.random.Generator], Parameters]:
    def draw(rng: np.random.Generator) -> Parameters:
        shift_s = sign * round(float(np.exp(rng.uniform(np.log(0.15), np.log(3600.0)))), 3)
        return {"duration_s": float(rng.choice([_PERIOD_S, 0.2, 0.5])), "shift_s": shift_s}

    return draw


def _drop(rng: np.random.Generator) -> Parameters:
    return {
        "duration_s": 1.0,
        "share": round(float(rng.uniform(0.2, 0.6)), 2),
        "seed": int(rng.integers(2**31)),
    }


def _stutter(rng: np.random.Generator) -> Parameters:
    return {"duration_s": 1.0, "every": int(rng.integers(5, 24))}


def _pause(rng: np.random.Generator) -> Parameters:
    return {"pause_s": round(float(rng.uniform(0.2, 1.5)), 3)}


def _foreign(rng: np.random.Generator) -> Parameters:
    return {"duration_s": 1.0, "share_of_limit": round(float(rng.uniform(-0.2, 0.2)), 3)}


def _always(expectation: Expectation) -> Callable[[Parameters], Expectation]:
    return lambda parameters: expectation


def _by_length(parameters: Parameters) -> Expectation:
    """Shorter than the time-out it must not matter, longer it must stop the arm."""
    return "ride" if parameters["duration_s"] < 0.5 * SILENCE_S else "stop"


_UNUSABLE = (
    "A few are ignored; when none that can be used has come for 0.1 s the trial is aborted with zero effort."
)
_WATCHDOG = f"The arm's own watchdog takes the effort away after {1e3 * WATCHDOG_S:.0f} ms; "
_LOOP_WHOLE = "It is no part of the control loop: the trial goes on."

KINDS: dict[str, Kind] = {
    kind.name: kind
    for kind in (
        Kind("state_nan", "states", "NaN as a position", _UNUSABLE, _brief_or_long, _by_length, STATES_LOST),
        Kind("state_inf", "states", "infinite position", _UNUSABLE, _brief_or_long, _by_length, STATES_LOST),
        Kind(
            "state_short",
            "states",
            "one position too few",
            _UNUSABLE,
            _brief_or_long,
            _by_length,
            STATES_LOST,
        ),
        Kind(
            "state_nameless",
            "states",
            "a joint is missing",
            _UNUSABLE,
            _brief_or_long,
            _by_length,
            STATES_LOST,
        ),
        Kind(
            *("state_huge", "states", "a position or velocity of 1e2 to 1e12, in 1 or 3 messages"),
            "The trial is aborted, or the messages are ignored.",
            *(_huge, _always("either"), STATES_LOST),
        ),
        Kind(
            *("state_reordered", "states", "neighbouring messages change places, for 0.1 s"),
            "What a newer state has overtaken is passed over.",
            *(lambda rng: {"duration_s": 0.1}, _always("either"), STATES_LOST),
        ),
        Kind(
            *("state_delayed", "states", "all are 10 to 60 ms late, for 1 s"),
            "Springs and dampers bear some lateness; if the arm begins to swing, the corridor ends it.",
            *(_delay, _always("either"), STATES_LOST),
        ),
        Kind(
            *("state_dropped", "states", "20 to 60 % get lost, for 1 s"),
            "The next state is answered.",
            *(_drop, _always("ride"), STATES_LOST),
        ),
        Kind(
            *("state_stutter", "states", "one every 20 to 92 ms gets through, for 1 s"),
            "No pause is long enough for a time-out, but an effort that is held so long is no damper any "
            "more. "
            "The trial is completed, or aborted before the arm swings up.",
            *(_stutter, _always("either"), STATES_LOST),
        ),
        Kind(
            *("state_silence", "states", "none for 1 s"),
            "No state, no commands: the arm's watchdog and the controller both take the effort away.",
            *(_one_second, _always("stop"), STATES_LOST),
        ),
        Kind(
            *("state_frozen", "states", "the same message again and again, for 1 s"),
            "A stamp that does not move is no new state: as silence.",
            *(_one_second, _always("stop"), STATES_LOST),
        ),
        Kind(
            *("state_time_back", "states", "stamps jump back by 0.15 s to an hour; later forward again"),
            "The trial is aborted and the arm braked: a state that does not follow the last says nothing.",
            *(_jump(-1.0), _always("stop"), STATES_LOST),
        ),
        Kind(
            *("state_time_forward", "states", "stamps jump forward by 0.15 s to an hour; later back again"),
            "As back.",
            *(_jump(1.0), _always("stop"), STATES_LOST),
        ),
        Kind(
            *("state_duplicate", "states", "a second publisher says the arm rests at zero, for 1 s"),
            "The trial is aborted: positions that jump or stamps that do not grow. Counted from the second's "
            "first message.",
            *(_one_second, _always("stop"), STATES_LOST + "|publish"),
        ),
        Kind(
            *("command_nan", "commands", "NaN as an effort"),
            "The arm does not apply it. It may coast meanwhile, and the trial go on, leave the corridor, or "
            "be aborted because the motors do not act.",
            *(_brief_or_long, _always("either"), ANY_REASON),
        ),
        Kind(
            *("command_inf", "commands", "infinite effort"),
            "As NaN.",
            *(_brief_or_long, _always("either"), ANY_REASON),
        ),
        Kind(
            *("command_short", "commands", "one effort too few"),
            "As NaN.",
            *(_brief_or_long, _always("either"), ANY_REASON),
        ),
        Kind(
            *("command_huge", "commands", "1e3 to 1e12 N·m in 1 to 5 messages"),
            "The arm clips it to its limit: a kick that the springs take up.",
            *(_huge_effort, _always("either"), ANY_REASON),
        ),
        Kind(
            *("command_reordered", "commands", "neighbouring messages change places, for 0.1 s"),
            "The effort is one period old now and then, which does no harm.",
            *(lambda rng: {"duration_s": 0.1}, _always("either"), ANY_REASON),
        ),
        Kind(
            *("command_delayed", "commands", "all are 10 to 60 ms late, for 1 s"),
            f"The driver refuses answers to states of more than {1e3 * COMMAND_AGE_LIMIT_S:.0f} ms ago: as "
            "silence.",
            *(_delay, _always("either"), ANY_REASON),
        ),
        Kind(
            *("command_stutter", "commands", "one every 20 to 92 ms gets through, for 1 s"),
            "As states that stutter.",
            *(_stutter, _always("either"), ANY_REASON),
        ),
        Kind(
            *("command_silence", "commands", "none reaches the arm for 1 s"),
            _WATCHDOG + "when commands return, the trial goes on within the corridor or has been aborted.",
            *(_one_second, _always("either"), ANY_REASON),
        ),
        Kind(
            *(
                "command_duplicate",
                "commands",
                "a second publisher commands up to 20 % of the limit, for 1 s",
            ),
            "Two that command one arm is never right: the trial is aborted. What the second sends reaches "
            "the drive all the same, so the arm is judged from its last message on.",
            *(_foreign, _always("stop"), ANY_REASON + "|commands the arm"),
        ),
        Kind(
            *("pause_ep_controller", "process", "SIGSTOP for 0.2 to 1.5 s"),
            _WATCHDOG + "on its return the controller finds that time has passed, and brakes.",
            *(_pause, _always("stop"), STATES_LOST),
            setups=IN_BETWEEN,
        ),
        Kind(
            *("pause_in_lockstep", "process", "ep_controller gets SIGSTOP for 0.2 to 1.5 s"),
            "The arm's time stands still, for 1 s at most: then it coasts without effort.",
            *(_pause, _always("either"), STATES_LOST),
            setups=LOCKSTEP,
        ),
        Kind(
            *("pause_sim_bridge", "process", "SIGSTOP for 0.2 to 1.5 s: the driver stands still"),
            "As silence of the states; the driver's motors do what they did until it runs again.",
            *(_pause, _always("stop"), STATES_LOST),
        ),
        *(
            Kind(
                f"pause_{node}",
                "process",
                "SIGSTOP for 0.2 to 1.5 s",
                _LOOP_WHOLE,
                *(_pause, _always("ride"), STATES_LOST),
                setups=_where(node),
                weight=0.5,
            )
            for node in (*OUTSIDE_THE_LOOP, "tel")
        ),
        Kind(
            *("kill_ep_controller", "process", "SIGKILL"),
            _WATCHDOG + "the run ends and says which node died.",
            *(_nothing, _always("stop"), "node ep_controller was killed by SIGKILL"),
            setups=EVERYWHERE,
            ends_run=True,
            codes=(3,),
        ),
        *(
            Kind(
                f"kill_{node}",
                "process",
                "SIGKILL",
                "The run ends: the controller brakes the arm, then its effort goes to zero.",
                *(_nothing, _always("end"), f"node {node} was killed by SIGKILL"),
                setups=_where(node),
                ends_run=True,
                codes=(3,),
                weight=0.7,
            )
            for node in OUTSIDE_THE_LOOP
        ),
        Kind(
            *("kill_sim_bridge", "process", "SIGKILL: the driver of the arm is gone"),
            "What the motors do is then the drive's business. The last command that anybody sends is zero.",
            *(
                _nothing,
                _always("end"),
                r"node sim_bridge was killed by SIGKILL|no joint state|the arm is not there",
            ),
            setups=("planar", *LOCKSTEP),
            ends_run=True,
            codes=(3,),
            weight=0.7,
        ),
        Kind(
            *("kill_tel", "process", "SIGKILL to `tel practice` itself"),
            "The kernel ends the nodes, the controller brakes before it goes; nobody is left to say so but "
            "the "
            "log of the controller.",
            *(_nothing, _always("end"), "CANCELLED|completed"),
            setups=EVERYWHERE,
            ends_run=True,
            codes=(-9,),
            weight=0.7,
        ),
        Kind(
            *("interrupt", "process", "SIGINT to `tel practice`"),
            "The controller brakes the arm, then its effort goes to zero.",
            *(_nothing, _always("end"), "interrupted"),
            setups=EVERYWHERE,
            ends_run=True,
            codes=(130,),
            weight=0.7,
        ),
        Kind(
            *("emergency_stop", "process", "somebody calls /safety/stop"),
            "The arm is braked and let go; the run ends and says why.",
            *(_nothing, _always("stop"), "emergency stop"),
            setups=IN_BETWEEN,
            ends_run=True,
            codes=(1,),
            weight=0.7,
        ),
        Kind(
            *("emergency_stop_in_lockstep", "process", "somebody calls /safety/stop"),
            "As in real time, as soon as the controller has looked for the call: the arm's time may go on by "
            "any amount until then.",
            *(_nothing, _always("end"), "emergency stop"),
            setups=LOCKSTEP,
            ends_run=True,
            codes=(1,),
            weight=0.3,
        ),
        Kind(
            *("hang_ep_controller", "process", "SIGSTOP for good"),
            _WATCHDOG + "the run ends because the controller does not answer.",
            *(_nothing, _always("stop"), "execute_trial was silent"),
            setups=("planar", *LOCKSTEP),
            ends_run=True,
            codes=(3,),
            weight=0.3,
        ),
        *(
            Kind(
                f"hang_{node}",
                "process",
                "SIGSTOP for good",
                "The trial goes on; the run ends when it is noticed that the node does not answer.",
                *(_nothing, _always("end"), says),
                setups=("lockstep",),
                ends_run=True,
                codes=(3,),
                weight=0.2,
            )
            for node, says in (
                ("trial_recorder", "trial_recorder"),
                ("practice_manager", "practice_manager|practice manager"),
            )
        ),
        Kind(
            *("hang_inverse_dynamics", "process", "SIGSTOP for good, and Ctrl-C 10 s later"),
            "Learning may take minutes, and the run waits for it as long (600 s); the arm is held "
            "meanwhile. Ctrl-C "
            "ends the run, whatever hangs.",
            *(_nothing, _always("end"), "interrupted"),
            setups=("lockstep",),
            ends_run=True,
            codes=(130,),
            weight=0.2,
            interrupt_after_s=10.0,
        ),
        Kind(
            *("disk_full", "disk", "the disk with the run's folder has no free block any more (ENOSPC)"),
            "The trial may end; its bag stays unfinished, the run ends and says so.",
            *(_nothing, _always("end"), "No space left on device|room on the disk"),
            setups=EVERYWHERE,
            ends_run=True,
            codes=(1, 3),
        ),
        Kind(
            *("recorder_file_limit", "disk", "no file of trial_recorder can grow any more (EFBIG)"),
            "As a full disk, for the recorder alone.",
            *(_nothing, _always("end"), "File too large|room on the disk"),
            setups=("planar", *LOCKSTEP),
            ends_run=True,
            codes=(1, 3),
            weight=0.7,
        ),
    )
}
