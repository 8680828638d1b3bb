"""The course of a trial: state in, effort out."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from tel_ros.core.arm_state import ArmState
from tel_ros.core.config import ArmConfig, ControlConfig, SafetyConfig
from tel_ros.core.control.holding import Hold, RestDetector
from tel_ros.core.control.set_point import SetPointGuard
from tel_ros.core.control.tracking import Approach, Limits, Target, TrialCourse
from tel_ros.core.errors import EffortError, TrajectoryError
from tel_ros.core.safety.layer import SafetyLayer
from tel_ros.core.safety.monitors import FirstMotion
from tel_ros.core.safety.rules import Permitted
from tel_ros.core.springs import Springs
from tel_ros.core.trial import Outcome, Phase, Tick, TrialGoal, TrialReport
from tel_ros.core.types import NS_PER_S, BoolArray, FloatArray

# Looked up here, they cost the loop a tenth.
IDLE, APPROACH, SETTLE, RUN, HOLD, STOP = Phase


class EpController:
    """Executes one trial at a time under equilibrium-point control.

    APPROACH (smoothly to the start posture) → SETTLE → RUN → HOLD; the trial is over when the arm is at rest
    in HOLD. Whatever goes wrong leads to STOP, where the arm is braked and held where it comes to rest; the
    trial is over then. After :meth:`stop_for` and :meth:`finish` the arm is held or released, as configured,
    and no trial starts. Nor does one where readings or wiring cannot be trusted: a brake would drive the arm
    then, so the effort goes to zero at once, and a position drive keeps its set point. Every effort has gone
    through the safety layer. Time is that of the states alone, so it may run slower or faster than the wall
    clock.

    The arm's empty limits must have been filled from the URDF.
    """

    def __init__(self, arm: ArmConfig, control: ControlConfig, safety: SafetyConfig | None = None) -> None:
        safety = safety or SafetyConfig()
        self.limits = Limits.of(arm, control.path_tolerance_rad)
        self._configured = self._springs = Springs.of(arm)
        self.safety = SafetyLayer(arm, safety, control.rate_hz)
        """Through which every effort goes."""
        position = arm.command_interface == "position"
        self._set_point = SetPointGuard(arm, control.state_timeout_s) if position else None
        # A position drive cannot release an arm: it holds its last set point.
        self._releases = safety.final_effort == "zero" and not position
        self._control = control
        self._state_timeout_ns = round(control.state_timeout_s * NS_PER_S)
        self._settle_timeout_ns = round(control.settle_timeout_s * NS_PER_S)
        self._rest = RestDetector(control.settle_speed_rad_s, control.settle_time_s)
        self._enter(IDLE, 0)
        self.report: TrialReport | None = None
        """Of the trial that has just ended; None while one is under way."""
        self._trial: TrialCourse | None = None  # the last one, also when it has ended
        self._last_ns = 0
        self._equilibrium: FloatArray | None = None
        self._velocity = np.zeros(len(arm.joints))
        self._hold, self._releasing = Hold(), False
        self.distrusts = False
        """Whether readings or wiring have been found wrong, until the stop is reset."""
        self._first_motion = None if position else FirstMotion(arm.joints, np.array(arm.effort_limit_nm))
        """Until a trial has been completed."""
        self._exerted_nm: FloatArray | None = None
        """By the springs in this tick; None: they tell nothing of a load."""
        self.stopped_for: str | None = None
        """Why no trial may start until :meth:`reset_stop`; None: one may."""

    @property
    def commands(self) -> SafetyLayer | SetPointGuard:
        """Whose ``last_command`` the arm is to get."""
        return self._set_point or self.safety

    @property
    def active(self) -> bool:
        """Whether a trial is under way."""
        return self._trial is not None and self.report is None

    @property
    def goal(self) -> TrialGoal | None:
        """Of the trial that is under way."""
        return self._trial.goal if self._trial and self.active else None

    @property
    def braking(self) -> bool:
        """Whether an arm whose trial has ended is still being brought to rest; while it moves, none starts.

        A loss of the states ends a trial in mid-motion, and the brake may take longer than a trial waits.
        """
        return self.phase is STOP and not (self.active or self._releasing or self._still)

    @property
    def max_error_rad(self) -> float:
        """Largest deviation of any joint in RUN so far, NaN before it."""
        return self._trial.score.max_error_rad if self._trial else math.nan

    @property
    def time_from_start_s(self) -> float:
        """Time of the last state since the beginning of RUN; -1 before it."""
        run_ns = self._trial.run_ns if self._trial else 0
        return (self._last_ns - run_ns) / NS_PER_S if run_ns else -1.0

    @property
    def at_final_effort(self) -> bool:
        """Whether :meth:`stop_for` or :meth:`finish` has come to its end: nothing more will change."""
        if self.stopped_for is None or self.active:
            return False
        if self.phase is IDLE:
            return True
        if self._releases or self._releasing:
            return self._releasing and not self.safety.last_nm.any()
        return self._rested(self._last_ns)

    def start(self, goal: TrialGoal) -> None:
        """Take up a trial with the next state.

        Raises:
            TrajectoryError: a trial is under way, the arm has been stopped for good or is still being braked,
                or the goal is one that the arm must not follow.
        """
        if self.stopped_for is not None:
            raise TrajectoryError(f"stopped: {self.stopped_for}; no trial starts before the stop is reset")
        if self.active:
            raise TrajectoryError("another trial is under way; one trial at a time")
        # A moment without states need not have moved an arm that was held.
        if self.braking and np.abs(self._velocity).max() >= self._control.settle_speed_rad_s:
            raise TrajectoryError("the arm is still being braked; a trial starts from rest")
        self.limits.check_goal(goal, self._control.settle_speed_rad_s)
        springs = goal.springs or self._configured
        springs.require_within(self._control.max_stiffness_factor, self._configured)
        if self._set_point is not None and not springs.equal(self._configured):
            raise TrajectoryError("the goal has springs of its own; expected none: they are the drive's")
        self.safety.response.forgive()
        self._trial, self.report = TrialCourse(goal), None
        # What is held at present is left smoothly; an arm that nobody holds is picked up where it is.
        self.phase = APPROACH

    def cancel(self) -> None:
        """Stop the trial that is under way, if any: the arm is brought to rest and held."""
        self._stop(Outcome.CANCELLED, "cancelled")

    def abort(self, reason: str) -> None:
        """Abort the trial that is under way, if any: the arm is brought to rest and held."""
        if self.active:
            self._stop(Outcome.ABORTED, reason)

    def stop_for(self, reason: str) -> None:
        """Stop now and for good: an emergency stop, latched until :meth:`reset_stop`.

        A trial that is under way is aborted with the reason as its message. The arm is braked; once it is at
        rest, it is held or released (``safety.final_effort``). An arm that is not held stays as it is.
        """
        self.stopped_for = self.stopped_for or reason
        self._stop(Outcome.ABORTED, reason)

    def finish(self) -> None:
        """End in good order: like :meth:`stop_for`, but a trial that is under way counts as cancelled."""
        self.stopped_for = self.stopped_for or "the controller is ending"
        self.cancel()

    def reset_stop(self) -> None:
        """Allow trials again. A trial picks up an arm that was released; any other stays held."""
        if self.stopped_for is None:
            return
        self.stopped_for, self.distrusts = None, False
        if self._releasing:
            if self.safety.last_nm.any():
                self._begin_stop(self._last_ns)
            else:
                self.phase, self._releasing, self._equilibrium = IDLE, False, None

    def lose_states(self, message: str) -> None:
        """End the trial because no states come any more; the effort must go to zero until they do.

        If states return, the arm is braked and held.
        """
        if self.phase is IDLE:
            return
        self.safety.none()
        if self._releasing:
            return
        self._hold.load.lose(self._springs.stiffness_nm_per_rad)
        self._stop(Outcome.ABORTED, message)
        self._begin_stop(self._last_ns)  # also in STOP: the arm is no longer held where it was latched
        if self._trial is not None and self.active:
            self.report = self._trial.report(self._last_ns)

    def tick(self, state: ArmState) -> Tick | None:
        """Answer one measured state: :meth:`decide` and :meth:`conclude` in one."""
        tick = self.decide(state)
        if tick is not None:
            self.conclude(state, tick)
        return tick

    def decide(self, state: ArmState) -> Tick | None:
        """Decide what to command in answer to a state; None: nothing yet. :meth:`conclude` has to follow."""
        trial = self._trial
        if self.phase is IDLE or trial is None:
            self._last_ns = state.time_ns
            return None
        if trial.ticks or not self.active:
            self._check(state)
        elif not self._begin(trial, state):
            self._last_ns = state.time_ns
            return None
        self._last_ns, self._velocity = state.time_ns, state.velocity_rad_s
        trial.ticks += 1
        self._advance(trial, state)
        target = self._target(trial, state)
        if self.phase is not STOP:
            limits = trial.way_back if self.phase is APPROACH else self.limits
            violation = limits.violation(state, target.position)
            if violation is not None:
                self._stop(Outcome.ABORTED, violation)
                target = self._target(trial, state)
        equilibrium, effort, saturated = self._command(state, target)
        self._equilibrium = equilibrium
        watched = not (self._releasing or self.phase is HOLD or self.safety.response.waits)
        if self._first_motion is not None and watched:
            fault = self._first_motion.look(state, equilibrium, effort)
            too_fast = self.phase is STOP and not trial.run_ns and self.limits.too_fast(state)
            if fault or too_fast:
                self._distrust(trial, fault or "no brake is tried before a first movement has gone well")
                effort = self.safety.none().effort_nm
        return Tick(self.phase, self.time_from_start_s, *target[:3], equilibrium, effort, saturated)

    def conclude(self, state: ArmState, tick: Tick) -> None:
        """Keep the books of a tick that :meth:`decide` has returned; the command need not wait for this."""
        if self._exerted_nm is not None:
            self._hold.load.add(state.time_ns, self._exerted_nm)
        if tick.phase is RUN and self._trial is not None:
            self._trial.score.add(state, tick)
        self._finish_if_over(state.time_ns)

    def _command(self, state: ArmState, target: Target) -> tuple[FloatArray, FloatArray, BoolArray]:
        """Return equilibrium points, efforts, and where these are not what the springs want."""
        permitted = self._effort(state, target)
        if self._set_point is None:
            return target.equilibrium, permitted.effort_nm, self.safety.response.lacking(permitted)
        if self.distrusts and self._set_point.last_command is not None:
            return self._set_point.last_command, *permitted
        sent, held_back = self._set_point.answer(permitted, target.equilibrium, self._springs, state)
        exerted = self._springs.effort(sent, state.position_rad, state.velocity_rad_s)
        return sent, self.safety.limit.nearest(exerted), permitted.changed | held_back

    def _effort(self, state: ArmState, target: Target) -> Permitted:
        """Return what the springs and dampers exert, as far as it is permitted."""
        self._exerted_nm = None
        if self.distrusts:
            return self.safety.none()  # the rules would answer the same readings
        if self._releasing:
            wanted = self.safety.fading(state.time_ns)
        else:
            wanted = self._springs.effort(target.equilibrium, state.position_rad, state.velocity_rad_s)
        try:
            permitted = self.safety.permit(state, wanted, self._pull(state, target))
        except EffortError as error:
            self._stop(Outcome.ABORTED, str(error))
            return self.safety.none()
        if self.safety.response.fault:
            self._stop(Outcome.ABORTED, self.safety.response.fault)
        if self.safety.readings.fault and self._trial is not None:
            self._distrust(self._trial, self.safety.readings.fault)
        if not self._releasing:
            self._exerted_nm = permitted.effort_nm
        return permitted

    def _pull(self, state: ArmState, target: Target) -> Callable[[int], float] | None:
        """Return how hard a spring would pull towards the desired position without what was learned."""
        if self.phase is STOP or self._trial is None:
            return None
        wanted = self._trial.wanted_rad(self.phase, target)
        stiffness, positions = self._springs.stiffness_nm_per_rad, state.positions
        return lambda j: float(stiffness[j] * (wanted[j] - positions[j]))

    def _check(self, state: ArmState) -> None:
        """Abort if a state is too old or time jumped."""
        if self._releasing:
            return
        step_ns, timeout_s = state.time_ns - self._last_ns, self._control.state_timeout_s
        if state.age_s > timeout_s:
            late = f"the joint states come {state.age_s:.3f} s late (time-out {timeout_s} s)"
            self._stop(Outcome.ABORTED, late)
        if 0 < step_ns <= self._state_timeout_ns:
            return
        jump = f"no joint state for {step_ns / NS_PER_S:.3f} s (time-out {timeout_s} s)"
        if step_ns <= 0:
            jump = f"the stamps of the joint states went back by {-step_ns / NS_PER_S:.3f} s"
        self._stop(Outcome.ABORTED, jump)
        # On the clock that counts from now on, which says when the arm has had its time to come to rest.
        self._begin_stop(state.time_ns)

    def _distrust(self, trial: TrialCourse, reason: str) -> None:
        """End the trial and let go of the arm for good: whatever is commanded could drive it."""
        if self.phase is STOP and self.active:
            trial.message += f"; {reason}"
        self.stop_for(reason)
        self.safety.none()
        self._releasing = self.distrusts = True
        if self.active:
            self.report = trial.report(self._last_ns)

    def _begin(self, trial: TrialCourse, state: ArmState) -> bool:
        """Take up a trial, unless the arm is where it cannot be: then it stays held, or alone, as it was."""
        trial.start_ns = state.time_ns
        if self.phase is not APPROACH:
            return True
        trial.message = self.limits.misplaced(state.position_rad)
        if not trial.message:
            self._begin_approach(trial, state)
            return True
        trial.outcome = Outcome.REFUSED
        self.report = trial.report(state.time_ns)
        if self._equilibrium is None:
            self.phase = IDLE
        else:
            self._begin_stop(state.time_ns)
        return False

    def _begin_approach(self, trial: TrialCourse, state: ArmState) -> None:
        goal = trial.goal
        # Springs stay until another trial brings its own: they brake and hold the arm, too.
        held, self._springs = self._springs, goal.springs or self._configured
        start = state.position_rad
        if self._equilibrium is not None:
            # Other springs go on with the effort that the ones before exert now.
            start = self._springs.equilibrium_for(held, self._equilibrium, start, state.velocity_rad_s)
        trial.approach = Approach(start, goal.equilibrium_rad[0], self._control.approach_speed_rad_s)
        trial.way_back = self.limits.reaching(state.position_rad)
        if self._first_motion is not None:
            self._first_motion.begin(state.positions)
        self._phase_ns = state.time_ns

    def _enter(self, phase: Phase, time_ns: int) -> None:
        self.phase, self._phase_ns, self._still = phase, time_ns, False
        self._rest.reset()

    def _advance(self, trial: TrialCourse, state: ArmState) -> None:
        """Go on to the next phase when it is time."""
        in_phase_ns = state.time_ns - self._phase_ns
        if self.phase is RUN:
            if in_phase_ns > trial.points.end_ns:
                self._enter(HOLD, state.time_ns)
            return
        self._still = self._rest.at_rest(state.time_ns, state.position_rad)
        if self._still and not self._releasing:
            self._hold.load.keep()
        if self.phase is APPROACH and in_phase_ns >= trial.approach.duration_ns:
            self._enter(SETTLE, state.time_ns)
        elif self.phase is SETTLE:
            if self._still:
                self._enter(RUN, state.time_ns)
                trial.run_ns = state.time_ns
            elif in_phase_ns > self._settle_timeout_ns:
                self._stop(Outcome.ABORTED, self._restless("at the start posture"))

    def _target(self, trial: TrialCourse, state: ArmState) -> Target:
        if self.phase is STOP:
            if self._releasing:
                return Target.at_rest(state.position_rad)
            if self.safety.response.fault:
                self._hold.lose(self._springs)
            late = self.safety.is_late(state)
            return Target.at_rest(self._hold.equilibrium(state, self._springs, self._still, late))
        return trial.target(self.phase, state.time_ns - self._phase_ns)

    def _stop(self, outcome: Outcome, message: str) -> None:
        if self.phase in (STOP, IDLE):
            return
        if self._trial is not None and self.active:
            self._trial.outcome, self._trial.message = outcome, message
        self._begin_stop(self._last_ns)

    def _begin_stop(self, time_ns: int) -> None:
        self._hold.begin()
        self._equilibrium, self._releasing = None, False
        self._enter(STOP, time_ns)

    def _rested(self, time_ns: int) -> bool:
        """Return whether STOP has brought the arm to rest, or will not."""
        return self._still or time_ns - self._phase_ns > self._settle_timeout_ns

    def _finish_if_over(self, time_ns: int) -> None:
        if self.stopped_for is not None and self._releases and self.phase is STOP:
            self._releasing = self._releasing or self._rested(time_ns)
        trial, resting = self._trial, self.phase in (HOLD, STOP)
        if trial is None or not (self.active and resting and self._rested(time_ns)):
            return
        if self.phase is HOLD and not self._still:
            self._stop(Outcome.ABORTED, self._restless("after the movement"))
            return
        if not self._still:
            trial.message += f"; it was {self._restless('under the brake')}"
        if trial.outcome == Outcome.COMPLETED:
            self._first_motion = None
        self.report = trial.report(time_ns, self.safety.response.shortfalls)

    def _restless(self, where: str) -> str:
        return f"not at rest {where} after {self._control.settle_timeout_s} s"
