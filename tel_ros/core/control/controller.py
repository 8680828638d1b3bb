"""The course of a trial: state in, effort out."""

from __future__ import annotations

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
    then, so the effort goes to zero at once, and a position drive keeps its set point. Time is that of the
    states alone. The arm's empty limits must have been filled from the URDF.
    """

    def __init__(self, arm: ArmConfig, control: ControlConfig, safety: SafetyConfig | None = None) -> None:
        safety = safety or SafetyConfig()
        self.limits = Limits.of(arm, control.path_tolerance_rad)
        self._configured = self._springs = Springs.of(arm)
        self.safety = SafetyLayer(arm, safety, control.rate_hz)
        """Through which every effort goes."""
        position = arm.command_interface == "position"
        self._set_point = SetPointGuard(arm, control.state_timeout_s) if position else None
        self.commands: SafetyLayer | SetPointGuard | EpController = self._set_point or self.safety
        """Whose ``last_command`` the arm is to get."""
        self._own_springs = arm.command_interface == "effort"
        # Who has the springs holds the arm, too: a drive its last set point, a controller its last posture.
        self._releases = safety.final_effort == "zero" and self._own_springs
        self._control = control
        self._rest = RestDetector.of(control)
        self._enter(IDLE, 0)
        self.report: TrialReport | None = None
        """Of the trial that has just ended; None while one is under way."""
        self.course: TrialCourse
        """Of the last trial, also when it has ended."""
        self._equilibrium: FloatArray | None = None
        self._last_ns, self._velocity = 0, np.zeros(len(arm.joints))
        self._hold, self._releasing = Hold(), False
        self.distrusts = False
        """Whether readings or wiring have been found wrong, until the stop is reset."""
        self._first_motion = None if position else FirstMotion(arm)  # until a trial has been completed
        self._exerted_nm: FloatArray | None = None  # by the springs; None: they tell nothing of a load
        self.stopped_for: str | None = None
        """Why no trial may start until :meth:`reset_stop`; None: one may."""

    @property
    def active(self) -> bool:
        """Whether a trial is under way."""
        return self.phase is not IDLE and self.report is None

    @property
    def goal(self) -> TrialGoal | None:
        """Of the trial that is under way."""
        return self.course.goal if self.active else None

    @property
    def braking(self) -> bool:
        """Whether an arm whose trial has ended, as by lost states, is still being brought to rest."""
        return self.phase is STOP and not (self.active or self._releasing or self._rest.still)

    @property
    def time_from_start_s(self) -> float:
        """Time of the last state since the beginning of RUN; -1 before it."""
        return (self._last_ns - self.course.run_ns) / NS_PER_S if self.course.run_ns else -1.0

    @property
    def at_final_effort(self) -> bool:
        """Whether :meth:`stop_for` or :meth:`finish` has come to its end: nothing more will change."""
        if self.stopped_for is None or self.active:
            return False
        if self.phase is IDLE:
            return True
        if self._releases or self._releasing:
            return self._releasing and not self.safety.last_nm.any()
        return self._rest.is_over(self._last_ns)

    def start(self, goal: TrialGoal) -> None:
        """Take up a trial with the next state; TrajectoryError: none can start, or not towards this goal."""
        if self.stopped_for:
            raise TrajectoryError(f"stopped: {self.stopped_for}; no trial starts before the stop is reset")
        if self.active:
            raise TrajectoryError("another trial is under way; one trial at a time")
        # A moment without states need not have moved an arm that was held.
        if self.braking and np.abs(self._velocity).max() >= self._control.settle_speed_rad_s:
            raise TrajectoryError("the arm is still being braked; a trial starts from rest")
        self.limits.check_goal(goal, self._control.settle_speed_rad_s)
        springs = goal.springs or self._configured
        springs.require_within(self._control.max_stiffness_factor, self._configured)
        self._check_springs(goal, springs)
        self.safety.response.forgive()
        self.course, self.report = TrialCourse(goal), None
        # What is held at present is left smoothly; an arm that nobody holds is picked up where it is.
        self.phase = APPROACH

    def cancel(self) -> None:
        """Stop the trial that is under way, if any: the arm is brought to rest and held."""
        self._stop("cancelled", Outcome.CANCELLED)

    def abort(self, reason: str) -> None:
        """Abort the trial that is under way, if any: the arm is brought to rest and held."""
        if self.active:
            self._stop(reason)

    def stop_for(self, reason: str) -> None:
        """Stop until :meth:`reset_stop`: a trial is aborted, the arm braked, then held or released."""
        self.stopped_for = self.stopped_for or reason
        self._stop(reason)

    def finish(self) -> None:
        """End in good order: like :meth:`stop_for`, but a trial that is under way counts as cancelled."""
        self.stopped_for = self.stopped_for or "the controller is ending"
        self.cancel()

    def reset_stop(self) -> None:
        """Allow trials again. A trial picks up an arm that was released; any other stays held."""
        self.stopped_for, self.distrusts = None, False
        if self._releasing:
            if self.safety.last_nm.any():
                self._begin_stop(self._last_ns)
            else:
                self.phase, self._releasing, self._equilibrium = IDLE, False, None

    def lose_states(self, message: str) -> None:
        """End the trial because no states come any more; when they return, the arm is braked and held."""
        if self.phase is IDLE:
            return
        self.safety.none()
        if self._releasing:
            return
        self._hold.load.lose(self._springs.stiffness_nm_per_rad)
        self._stop(message)
        self._begin_stop(self._last_ns)  # also in STOP: the arm is no longer held where it was latched
        if self.active:
            self.report = self.course.report(self._last_ns)

    def tick(self, state: ArmState) -> Tick | None:
        """Answer one measured state: :meth:`decide` and :meth:`conclude` in one."""
        if (tick := self.decide(state)) is not None:
            self.conclude(state, tick)
        return tick

    def decide(self, state: ArmState) -> Tick | None:
        """Decide what to command in answer to a state; None: nothing yet. :meth:`conclude` has to follow."""
        if self.phase is not IDLE:
            trial = self.course
            begins = not trial.ticks and self.active
            if not (begins or self._releasing):
                self._check(state)
        self._last_ns = state.time_ns
        if self.phase is IDLE or (begins and not self._begin(trial, state)):
            return None
        trial.ticks += 1
        self._advance(trial, state)
        target = self._target(trial, state)
        if self.phase is not STOP:
            limits = trial.way_back if self.phase is APPROACH else self.limits
            if violation := limits.violation(state, target.position):
                self._stop(violation)
                target = self._target(trial, state)
        equilibrium, effort, saturated = self._command(state, target)
        self._equilibrium, self._velocity = equilibrium, state.velocity_rad_s
        watched = not (self.distrusts or self._releasing or self.phase is HOLD or self.safety.response.waits)
        if self._first_motion is not None and watched:
            fault = self._first_motion.look(state, equilibrium, effort)
            too_fast = self.phase is STOP and not trial.run_ns and self.limits.too_fast(state)
            if fault or too_fast:
                self._distrust(fault or "no brake is tried before a first movement has gone well")
                effort = self.safety.none().effort_nm
        return Tick(self.phase, self.time_from_start_s, *target[:3], equilibrium, effort, saturated)

    def conclude(self, state: ArmState, tick: Tick) -> None:
        """Keep the books of a tick that :meth:`decide` has returned; the command need not wait for this."""
        if self._exerted_nm is not None:
            self._hold.load.add(state.time_ns, self._exerted_nm)
        if tick.phase is RUN:
            self.course.score.add(state, tick)
        self._finish_if_over(state.time_ns)

    def _command(self, state: ArmState, target: Target) -> tuple[FloatArray, FloatArray, BoolArray]:
        """Return equilibrium points, efforts, and where these are not what the springs want."""
        permitted = self._effort(state, target)
        if self._set_point is None:
            return target.equilibrium, permitted.effort_nm, self.safety.response.lacking(permitted)
        if self.distrusts and self._set_point.last_command is not None:
            return self._set_point.last_command, *permitted
        return self._set_point.answer(permitted, target.equilibrium, self._springs, state)

    def _effort(self, state: ArmState, target: Target) -> Permitted:
        self._exerted_nm = None
        if self.distrusts:
            return self.safety.none()  # the rules would answer the same readings
        if self._releasing:
            wanted = self.safety.fading(state.time_ns)
        else:
            wanted = self._springs.effort(target.equilibrium, state.position_rad, state.velocity_rad_s)
        pull = None  # without what was learned
        if self.phase is not STOP:
            pull = self._springs.pull(self.course.wanted_rad(self.phase, target), state)
        try:
            permitted = self.safety.permit(state, wanted, pull)
        except EffortError as error:
            self._stop(str(error))
            return self.safety.none()
        if self.safety.response.fault:
            self._stop(self.safety.response.fault)
        if self.safety.readings.fault:
            self._distrust(self.safety.readings.fault)
        if not self._releasing:
            self._exerted_nm = permitted.effort_nm
        return permitted

    def _check_springs(self, goal: TrialGoal, springs: Springs) -> None:
        """Refuse a goal that the springs cannot follow, with a TrajectoryError."""
        if not (self._own_springs or springs.equal(self._configured)):
            raise TrajectoryError("the goal has springs of its own; expected none: they are the drive's")

    def _check(self, state: ArmState) -> None:
        """Abort if a state is too old or time jumped."""
        step_s, timeout_s = (state.time_ns - self._last_ns) / NS_PER_S, self._control.state_timeout_s
        if state.age_s > timeout_s:
            self._stop(f"the joint states come {state.age_s:.3f} s late (time-out {timeout_s} s)")
        if not 0.0 < step_s <= timeout_s:
            back = f"the stamps of the joint states went back by {abs(step_s):.3f} s"
            self._stop(
                f"no joint state for {step_s:.3f} s (time-out {timeout_s} s)" if step_s > 0.0 else back
            )
            # On the clock that counts from now on, which says when the arm has had its time to come to rest.
            self._begin_stop(state.time_ns)

    def _distrust(self, reason: str) -> None:
        """End the trial and let go of the arm for good: whatever is commanded could drive it."""
        if self.phase is STOP and self.active:
            self.course.message += f"; {reason}"
        self.stop_for(reason)
        self.safety.none()
        self._releasing = self.distrusts = True
        if self.active:
            self.report = self.course.report(self._last_ns)

    def _begin(self, trial: TrialCourse, state: ArmState) -> bool:
        """Take up a trial, unless the arm is where it cannot be: then it stays held, or alone, as it was."""
        trial.start_ns = state.time_ns
        if self.phase is not APPROACH:
            return True
        trial.message = self.limits.misplaced(state.position_rad)
        if trial.message:
            trial.outcome = Outcome.REFUSED
            self.report = trial.report(state.time_ns)
            if self._equilibrium is None:
                self.phase = IDLE
            else:
                self._begin_stop(state.time_ns)
            return False
        # Springs stay until another trial brings its own: they brake and hold the arm, too.
        held, self._springs = self._springs, trial.goal.springs or self._configured
        start = state.position_rad
        if self._equilibrium is not None:
            start = self._springs.equilibrium_for(held, self._equilibrium, start, state.velocity_rad_s)
        trial.approach = Approach(start, trial.points.first.equilibrium, self._control.approach_speed_rad_s)
        trial.way_back = self.limits.reaching(state.position_rad)
        if self._first_motion is not None:
            self._first_motion.begin(state.positions)
        self._rest.begun_ns = state.time_ns
        return True

    def _enter(self, phase: Phase, time_ns: int) -> None:
        self.phase = phase
        self._rest.begin(time_ns)

    def _advance(self, trial: TrialCourse, state: ArmState) -> None:
        """Go on to the next phase when it is time."""
        in_phase_ns = state.time_ns - self._rest.begun_ns
        if self.phase is RUN:
            if in_phase_ns > trial.points.end_ns:
                self._enter(HOLD, state.time_ns)
            return
        self._rest.at_rest(state.time_ns, state.position_rad)
        if self._rest.still and not self._releasing:
            self._hold.load.keep()
        if self.phase is APPROACH and in_phase_ns >= trial.approach.duration_ns:
            self._enter(SETTLE, state.time_ns)
        elif self.phase is SETTLE:
            if begun_ns := self._run_begins_ns(state):
                self._enter(RUN, begun_ns)
                trial.run_ns = begun_ns
            elif self._rest.is_over(state.time_ns) and not self._rest.still:
                self._stop(self._restless("at the start posture"))

    def _run_begins_ns(self, state: ArmState) -> int:
        """Return when RUN has begun; 0: not yet."""
        return state.time_ns if self._rest.still else 0

    def _target(self, trial: TrialCourse, state: ArmState) -> Target:
        if self.phase is STOP:
            if self._releasing:
                return Target.at_rest(state.position_rad)
            if self.safety.response.fault:
                self._hold.lose(self._springs)
            late = self.safety.is_late(state)
            return Target.at_rest(self._hold.equilibrium(state, self._springs, self._rest.still, late))
        return trial.target(self.phase, state.time_ns - self._rest.begun_ns)

    def _stop(self, message: str, outcome: Outcome = Outcome.ABORTED) -> None:
        if self.phase not in (STOP, IDLE):
            if self.active:
                self.course.outcome, self.course.message = outcome, message
            self._begin_stop(self._last_ns)

    def _begin_stop(self, time_ns: int) -> None:
        self._hold.begin()
        self._equilibrium, self._releasing = None, False
        self._enter(STOP, time_ns)

    def _finish_if_over(self, time_ns: int) -> None:
        if self.phase not in (HOLD, STOP) or not self._rest.is_over(time_ns):
            return
        if self.stopped_for is not None and self._releases and self.phase is STOP:
            self._releasing = True
        if not self.active:
            return
        if self.phase is HOLD and not self._rest.still:
            return self._stop(self._restless("after the movement"))
        trial = self.course
        if not self._rest.still:
            trial.message += f"; it was {self._restless('under the brake')}"
        if trial.outcome == Outcome.COMPLETED:
            self._first_motion = None
        self.report = trial.report(time_ns, self.safety.response.shortfalls)

    def _restless(self, where: str) -> str:
        return f"not at rest {where} after {self._control.settle_timeout_s} s"
