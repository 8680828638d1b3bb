"""The course of a trial: state in, effort out."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from tel_ros.core.arm_state import ArmState
from tel_ros.core.config import ArmConfig, ControlConfig, SafetyConfig
from tel_ros.core.control.brake import SpringBrake
from tel_ros.core.control.ep_law import EpLaw
from tel_ros.core.control.load import HoldingLoad
from tel_ros.core.control.rest import RestDetector
from tel_ros.core.control.set_point import SetPointGuard
from tel_ros.core.control.tracking import TrackingScore
from tel_ros.core.errors import EffortError, TrajectoryError
from tel_ros.core.safety.late_states import LEAST_SHARE
from tel_ros.core.safety.layer import Permitted, SafetyLayer
from tel_ros.core.safety.limits import Limits
from tel_ros.core.safety.state_age import StateAge
from tel_ros.core.springs import Springs
from tel_ros.core.trajectories.trajectory import MINIMUM_JERK_PEAK_SPEED, minimum_jerk
from tel_ros.core.trial import Outcome, Phase, Tick, TrialGoal, TrialReport
from tel_ros.core.types import NS_PER_S, BoolArray, FloatArray

SHORTEST_APPROACH_S = 0.5
FORGOTTEN_AFTER_S = 0.05
"""An arm that has had less than that for so long is no longer where its load is known."""


@dataclass(slots=True)
class _Target:
    """Where the joints should be now, and what the springs pull towards. Shapes (n_joints,)."""

    position: FloatArray
    velocity: FloatArray
    acceleration: FloatArray
    equilibrium: FloatArray


class EpController:
    """Executes one trial at a time under equilibrium-point control.

    APPROACH (smoothly to the start posture) → SETTLE → RUN → HOLD; the trial is over when the arm is at rest
    in HOLD. Whatever goes wrong leads to STOP, where the arm is braked and held where it comes to rest; the
    trial is over then. After :meth:`stop_for` and :meth:`finish` the arm is held or let go, as configured,
    and no trial starts. Every effort has gone through the safety layer. Time is that of the states alone, so
    it runs slower or faster than the wall clock just as well.

    Args:
        arm: joints, springs and limits; its empty limits must have been filled from the URDF.
        control: corridor, settling and time-outs.
        safety: numbers of the safety layer, and what the arm is left with after a stop that is final; None:
            the defaults.
    """

    def __init__(self, arm: ArmConfig, control: ControlConfig, safety: SafetyConfig | None = None) -> None:
        safety = safety or SafetyConfig()
        self.limits = Limits.of(arm, control.path_tolerance_rad)
        self._configured = Springs.of(arm)
        self._springs = self._configured
        self._law = EpLaw(
            self._springs.stiffness_nm_per_rad,
            self._springs.damping_nms_per_rad,
        )
        self.safety = SafetyLayer(arm, safety, control.rate_hz)
        """Through which every effort goes."""
        self._set_point = (
            SetPointGuard(arm, control.state_timeout_s) if arm.command_interface == "position" else None
        )
        # A position drive cannot let go: it holds its last set point.
        self._lets_go = safety.final_effort == "zero" and self._set_point is None
        self._control = control
        self._n_joints = len(arm.joints)
        self._age = StateAge(control.state_timeout_s)
        self._settle_timeout_ns = round(control.settle_timeout_s * NS_PER_S)
        self.phase = Phase.IDLE
        self.report: TrialReport | None = None
        """Of the trial that has just ended; None while one is under way."""
        self._goal: TrialGoal | None = None
        self._times_ns: list[int] = []
        self._outcome = Outcome.COMPLETED
        self._message = ""
        self._score = TrackingScore(self._n_joints)
        self._ticks = 0
        self._start_ns = self._run_ns = self._phase_ns = self._last_ns = 0
        self._equilibrium: FloatArray | None = None
        self._velocity = np.zeros(self._n_joints)
        self._held = _Target(*(np.zeros(self._n_joints) for _ in range(4)))
        self._approach_from = np.zeros(self._n_joints)
        self._approach_s = 0.0
        self._way_back = self.limits
        self._point = 0
        self._brake: SpringBrake | None = None
        self._late_since_ns: int | None = None
        self._load = HoldingLoad()
        self._exerted_nm: FloatArray | None = None
        """By the springs in this tick, for the books; None: by nothing that tells of a load."""
        self._letting_go = False
        self.stopped_for: str | None = None
        """Why no trial may start until :meth:`reset_stop`; None: one may."""
        self._rest = self._new_rest_detector()
        self._still = False

    @property
    def commands(self) -> SafetyLayer | SetPointGuard:
        """Who keeps what the arm is to get now."""
        return self._set_point or self.safety

    @property
    def active(self) -> bool:
        """Whether a trial is under way."""
        return self._goal is not None

    @property
    def braking(self) -> bool:
        """Whether an arm whose trial has ended is still being brought to rest; while it moves, none starts.

        So it is after a loss of the states, which ends a trial in mid-motion, and when the brake has taken
        longer than a trial waits for it.
        """
        return self.phase == Phase.STOP and not (self.active or self._letting_go or self._still)

    @property
    def goal(self) -> TrialGoal | None:
        """The trial that is under way."""
        return self._goal

    @property
    def max_error_rad(self) -> float:
        """Largest deviation of any joint in RUN so far, NaN before it."""
        return self._score.max_error_rad

    @property
    def time_from_start_s(self) -> float:
        """Time of the last state since the beginning of RUN; -1 before it."""
        return (self._last_ns - self._run_ns) / NS_PER_S if self._run_ns else -1.0

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
        if goal.springs is not None:
            goal.springs.require_within(self._control.max_stiffness_factor, self._configured)
            if self._set_point is not None and not goal.springs.equal(self._configured):
                raise TrajectoryError("the goal has springs of its own; expected none: they are the drive's")
        self.safety.response.forgive()
        self._goal, self.report = goal, None
        self._times_ns = goal.desired.time_ns.tolist()
        self._outcome, self._message = Outcome.COMPLETED, ""
        self._score, self._ticks, self._run_ns, self._start_ns = TrackingScore(self._n_joints), 0, 0, 0
        # What is held at present is left smoothly; an arm that nobody holds is picked up where it is.
        self.phase = Phase.APPROACH

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
        rest, it is held or let go (``safety.final_effort``). What nobody holds stays as it is.
        """
        self._end(Outcome.ABORTED, reason, reason)

    def finish(self) -> None:
        """End in good order: like :meth:`stop_for`, but a trial that is under way counts as cancelled."""
        self._end(Outcome.CANCELLED, "cancelled", "the controller is ending")

    def reset_stop(self) -> None:
        """Allow trials again. An arm that is not yet let go is held; one that is, is picked up by a trial."""
        if self.stopped_for is None:
            return
        self.stopped_for = None
        if self._letting_go:
            if self.safety.last_nm.any():
                self._begin_stop(self._last_ns)
            else:
                self.phase, self._letting_go, self._equilibrium = Phase.IDLE, False, None

    @property
    def at_final_effort(self) -> bool:
        """Whether :meth:`stop_for` or :meth:`finish` has come to its end: nothing more will change."""
        if self.stopped_for is None or self.active:
            return False
        if self.phase == Phase.IDLE:
            return True
        if self._lets_go:
            return self._letting_go and not self.safety.last_nm.any()
        return self._rested(self._last_ns)

    def lose_states(self, message: str) -> None:
        """End the trial because no states come any more; effort must go to zero until they do.

        There is nothing to compute an effort from. If states return, the arm is braked and held.
        """
        if self.phase == Phase.IDLE:
            return
        self.safety.none()
        if self._letting_go:
            return  # it stays let go
        self._load.lose(self._springs.stiffness_nm_per_rad)
        self._stop(Outcome.ABORTED, message)
        self._begin_stop(self._last_ns)  # also in STOP: nobody holds the arm any more where it was latched
        self._finish()

    def tick(self, state: ArmState) -> Tick | None:
        """Answer one measured state: :meth:`decide` and :meth:`conclude` in one.

        Returns:
            What was decided, with the effort to command; None if nothing is to be commanded yet.
        """
        tick = self.decide(state)
        if tick is not None:
            self.conclude(state, tick)
        return tick

    def decide(self, state: ArmState) -> Tick | None:
        """Decide what to command in answer to a state; :meth:`conclude` is to follow.

        Returns:
            As :meth:`tick`.
        """
        if self.phase == Phase.IDLE:
            self._last_ns = state.time_ns
            return None
        self._check(state)
        if self._ticks == 0:
            self._start_ns = state.time_ns
            if self.phase == Phase.APPROACH:
                self._begin_approach(state)
        self._last_ns, self._velocity = state.time_ns, state.velocity_rad_s
        self._ticks += 1
        self._advance(state)
        target = self._target(state)
        if self.phase != Phase.STOP:
            limits = self._way_back if self.phase == Phase.APPROACH else self.limits
            violation = limits.violation(state, target.position)
            if violation is not None:
                self._stop(Outcome.ABORTED, violation)
                target = self._target(state)
        equilibrium, effort, saturated = self._command(state, target)
        self._equilibrium = equilibrium
        return Tick(
            phase=self.phase,
            time_from_start_s=self.time_from_start_s,
            desired_position_rad=target.position,
            desired_velocity_rad_s=target.velocity,
            desired_acceleration_rad_s2=target.acceleration,
            equilibrium_rad=equilibrium,
            effort_nm=effort,
            saturated=saturated,
        )

    def conclude(self, state: ArmState, tick: Tick) -> None:
        """Keep the books of a tick, for which a command that is on its way need not wait.

        Args:
            state: that :meth:`decide` was given.
            tick: that it has returned.
        """
        if self._exerted_nm is not None:
            self._load.add(state.time_ns, self._exerted_nm)
        if tick.phase == Phase.RUN:
            self._score.add(state.position_rad - tick.desired_position_rad, tick.effort_nm, tick.saturated)
        self._finish_if_over(state.time_ns)

    def _command(self, state: ArmState, target: _Target) -> tuple[FloatArray, FloatArray, BoolArray]:
        """Return equilibrium points, efforts, and whether something but the law has decided on them."""
        permitted = self._effort(state, target)
        if self._set_point is None:
            return target.equilibrium, *permitted
        # The set point at which the drive exerts what is permitted.
        asked = np.where(
            permitted.changed,
            self._law.equilibrium(permitted.effort_nm, state.position_rad, state.velocity_rad_s),
            target.equilibrium,
        )
        sent, held_back = self._set_point.follow(asked, state)
        exerted = self._law.effort(sent, state.position_rad, state.velocity_rad_s)
        return sent, self.safety.limit.nearest(exerted), permitted.changed | held_back

    def _effort(self, state: ArmState, target: _Target) -> Permitted:
        """Return what the springs and dampers exert, as far as it is permitted."""
        self._exerted_nm = None
        if self._letting_go:
            wanted = self.safety.fading(state.time_ns)
        else:
            wanted = self._law.effort(target.equilibrium, state.position_rad, state.velocity_rad_s)
        try:
            permitted = self.safety.permit(state, wanted)
        except EffortError as error:
            self._stop(Outcome.ABORTED, str(error))
            return self.safety.none()
        if self.safety.response.fault:
            self._stop(Outcome.ABORTED, self.safety.response.fault)
        if not self._letting_go:
            self._exerted_nm = permitted.effort_nm
        return permitted

    def _check(self, state: ArmState) -> None:
        """Abort if time jumped: a state that does not follow the last one says nothing about now."""
        if self._ticks == 0 or self._letting_go:
            return
        old = self._age.too_old(state.age_s)
        if old is not None:
            self._stop(Outcome.ABORTED, old)
        violation = self._age.violation(state.time_ns - self._last_ns)
        if violation is None:
            return
        self._stop(Outcome.ABORTED, violation)
        # On the clock that counts from now on, which says when the arm has had its time to come to rest.
        self._begin_stop(state.time_ns)

    def _begin_approach(self, state: ArmState) -> None:
        assert self._goal is not None
        held = self._springs
        self._take_up_springs(self._goal.springs or self._configured)
        if self._equilibrium is None:
            start = state.position_rad
        else:
            # Other springs go on with the effort that the ones before exert now.
            start = self._springs.equilibrium_for(
                held, self._equilibrium, state.position_rad, state.velocity_rad_s
            )
        self._approach_from = start
        distance = float(np.abs(self._goal.equilibrium_rad[0] - start).max())
        peak = MINIMUM_JERK_PEAK_SPEED * distance / self._control.approach_speed_rad_s
        self._approach_s = max(peak, SHORTEST_APPROACH_S)
        self._way_back = self.limits.reaching(state.position_rad)
        self._phase_ns = state.time_ns

    def _take_up_springs(self, springs: Springs) -> None:
        """Change K and B, which stay until another trial brings its own: they brake and hold the arm, too."""
        self._springs = springs
        self._law = replace(
            self._law,
            stiffness_nm_per_rad=springs.stiffness_nm_per_rad,
            damping_nms_per_rad=springs.damping_nms_per_rad,
        )

    def _enter(self, phase: Phase, time_ns: int) -> None:
        self.phase, self._phase_ns = phase, time_ns
        self._rest, self._still = self._new_rest_detector(), False

    def _advance(self, state: ArmState) -> None:
        """Go on to the next phase when it is time."""
        in_phase_ns = state.time_ns - self._phase_ns
        if self.phase != Phase.RUN:
            self._still = self._rest.at_rest(state.time_ns, state.position_rad)
        if self._still and not self._letting_go:
            self._load.keep()
        if self.phase == Phase.APPROACH and in_phase_ns >= self._approach_s * NS_PER_S:
            self._enter(Phase.SETTLE, state.time_ns)
        elif self.phase == Phase.SETTLE:
            if self._still:
                self._enter(Phase.RUN, state.time_ns)
                self._run_ns, self._point = state.time_ns, 0
            elif in_phase_ns > self._settle_timeout_ns:
                self._stop(Outcome.ABORTED, self._restless("at the start posture"))
        elif self.phase == Phase.RUN:
            assert self._goal is not None
            if in_phase_ns > self._times_ns[-1]:
                self._held = self._trajectory_target(len(self._times_ns) - 1, 0.0)
                self._enter(Phase.HOLD, state.time_ns)

    def _target(self, state: ArmState) -> _Target:
        if self.phase == Phase.RUN:
            return self._run_target(state.time_ns)
        zero = np.zeros(self._n_joints)
        if self.phase == Phase.APPROACH:
            assert self._goal is not None
            phase = (state.time_ns - self._phase_ns) / (self._approach_s * NS_PER_S)
            s = minimum_jerk(np.array([phase]))[0][0]
            u = self._approach_from + s * (self._goal.equilibrium_rad[0] - self._approach_from)
            return _Target(u, zero, zero, u)
        if self.phase == Phase.SETTLE:
            return self._trajectory_target(0, 0.0)
        if self.phase == Phase.HOLD:
            return self._held
        u = state.position_rad if self._letting_go else self._stopping_equilibrium(state)
        return _Target(u, zero, zero, u)

    def _stopping_equilibrium(self, state: ArmState) -> FloatArray:
        if self.safety.response.fault:
            # Nothing holds the arm. Springs that are latched anew have nothing to fling it with afterwards.
            self._load.lose(self._springs.stiffness_nm_per_rad)
            self._brake = None
        if self.safety.share_for(state) >= LEAST_SHARE:
            self._late_since_ns = None
        else:
            if self._late_since_ns is None:
                self._late_since_ns = state.time_ns
            if state.time_ns - self._late_since_ns > FORGOTTEN_AFTER_S * NS_PER_S:
                self._load.lose(self._springs.stiffness_nm_per_rad)
                self._brake = None
            elif self._brake is not None:
                self._brake.latch(state.position_rad)
        if self._brake is None:
            load_rad = self._load.deflection_rad(self._springs.stiffness_nm_per_rad)
            self._brake = SpringBrake(state.position_rad, load_rad)
        return self._brake.equilibrium(state.position_rad, state.velocity_rad_s, self._still)

    def _run_target(self, time_ns: int) -> _Target:
        assert self._goal is not None
        times = self._times_ns
        t = time_ns - self._run_ns
        k, last = self._point, len(times) - 1
        while k < last and times[k + 1] <= t:
            k += 1
        self._point = k
        if k == last:
            return self._trajectory_target(last, 0.0)
        return self._trajectory_target(k, float(t - times[k]) / float(times[k + 1] - times[k]))

    def _trajectory_target(self, k: int, share: float) -> _Target:
        """Return the goal at point k, or by linear interpolation between k and k + 1."""
        assert self._goal is not None
        desired = self._goal.desired
        q, v, a = desired.position_rad, desired.velocity_rad_s, desired.acceleration_rad_s2
        u = self._goal.equilibrium_rad
        if share == 0.0:
            return _Target(q[k], v[k], a[k], u[k])
        return _Target(*((1.0 - share) * row[k] + share * row[k + 1] for row in (q, v, a, u)))

    def _stop(self, outcome: Outcome, message: str) -> None:
        if self.phase in (Phase.STOP, Phase.IDLE):
            return
        if self.active:
            self._outcome, self._message = outcome, message
        self._begin_stop(self._last_ns)

    def _end(self, outcome: Outcome, message: str, reason: str) -> None:
        if self.stopped_for is None:
            self.stopped_for = reason
        self._stop(outcome, message)

    def _begin_stop(self, time_ns: int) -> None:
        self._brake = None
        self._late_since_ns = None
        self._equilibrium = None
        self._letting_go = False
        self._enter(Phase.STOP, time_ns)

    def _rested(self, time_ns: int) -> bool:
        """Return whether STOP has brought the arm to rest, or will not."""
        return self._still or time_ns - self._phase_ns > self._settle_timeout_ns

    def _finish_if_over(self, time_ns: int) -> None:
        if self.stopped_for is not None and self._lets_go and self.phase == Phase.STOP:
            self._letting_go = self._letting_go or self._rested(time_ns)
        if not self.active or self.phase not in (Phase.HOLD, Phase.STOP):
            return
        if self._still:
            self._finish()
        elif time_ns - self._phase_ns > self._settle_timeout_ns:
            if self.phase == Phase.HOLD:
                self._stop(Outcome.ABORTED, self._restless("after the movement"))
            else:
                self._message += f"; it was {self._restless('under the brake')}"
                self._finish()

    def _finish(self) -> None:
        if self._goal is None:
            return
        self.report = TrialReport(
            index=self._goal.index,
            alpha=self._goal.alpha,
            duration_s=self._goal.desired.duration_s,
            outcome=self._outcome,
            message=self._message,
            start_ns=self._start_ns,
            run_ns=self._run_ns,
            end_ns=self._last_ns,
            ticks=self._ticks,
            rms_error_rad=self._score.rms_error_rad,
            rms_error_per_joint_rad=self._score.rms_error_per_joint_rad,
            max_error_rad=self._score.max_error_rad,
            max_effort_nm=self._score.max_effort_nm,
            saturated_ratio=self._score.saturated_ratio,
        )
        self._goal = None

    def _restless(self, where: str) -> str:
        return f"not at rest {where} after {self._control.settle_timeout_s} s"

    def _new_rest_detector(self) -> RestDetector:
        return RestDetector(self._control.settle_speed_rad_s, self._control.settle_time_s)
