"""The equilibrium-point controller: joint states in, commands out, one trial at a time."""

from __future__ import annotations

import time
from functools import partial
from typing import Any

from sensor_msgs.msg import JointState
from std_msgs.msg import Bool
from tel_interfaces.msg import ControlState

from tel_ros.core.arm_state import ArmState
from tel_ros.core.control.loop_timing import LoopTimer
from tel_ros.core.control.observed import controller_of
from tel_ros.core.errors import StateError
from tel_ros.core.safety.gate import StateGate
from tel_ros.core.trial import Outcome
from tel_ros.local_stop import ENDED
from tel_ros.nodes import qos
from tel_ros.nodes.clock import STEADY, longest_silence_s
from tel_ros.nodes.command_channel import LEFT, CommandChannel, CompetingPublishers
from tel_ros.nodes.controller_services import SafetyServices, SeenArm, TrialServer, replay_control
from tel_ros.nodes.conversions import idle_state, joint_state_reader
from tel_ros.nodes.diagnostics import Diagnostics, Health, Level, RateMeter
from tel_ros.nodes.hot_loop import busy_subscription
from tel_ros.nodes.lifecycle import ManagedNode, TransitionRefusedError
from tel_ros.nodes.parameters import declare_resume, load_parameters
from tel_ros.nodes.realtime import apply_realtime_options
from tel_ros.nodes.runner import run_node
from tel_ros.recording import topics
from tel_ros.recording.cdr import ControlStateLayout

COMPLAINT_PERIOD_S = 1.0
TIMED_S = 60.0
"""Trials up to this long are timed without asking for memory on the way."""


class EpControllerNode(ManagedNode):
    """Answers every joint state with a command while a trial is under way or its end is held.

    Nothing is commanded before the node is active, and then nothing before the first trial. An arm whose time
    stands still without commands (the simulated one in lockstep) is left alone between trials as well, so
    that a run does not depend on how long learning takes.
    """

    def __init__(self) -> None:
        super().__init__("ep_controller")
        config = load_parameters(self, "arm", "control", "run", "safety", "sim")
        arm, control, waits = config.arm, config.control, config.arm_waits_for_commands
        self._joints = arm.joints
        self._make_controller = partial(controller_of, arm, control, config.safety)
        self._controller = self._make_controller()
        run = declare_resume(self)
        # A real arm may have been moved meanwhile, and what another controller was told is not recorded.
        follows = arm.command_interface == "trajectory"
        replays = waits and not follows
        if run is not None and replays and not replay_control(self._controller, run, self._joints):
            self.get_logger().warning("not all decisions are recorded: the arm is picked up where it is")
            self._controller = self._make_controller()
        self._interface = arm.command_interface
        self._holds_at_the_end = self._interface != "effort" or config.safety.final_effort == "hold"
        self._answers_between_trials = not waits
        timeout_s = config.sim.lockstep_timeout_s if waits else control.state_timeout_s
        self._arm = SeenArm(self._joints, control, timeout_s)
        self._silence_s = timeout_s if waits else longest_silence_s(timeout_s)
        self._read = joint_state_reader()
        # Who has the springs brakes with states that are never late.
        wall_clock = not waits and self._interface == "effort"
        self._gate = StateGate(arm, control, config.safety.clock_drift if wall_clock else None)
        self._estimated: tuple[str, ...] = ()
        self._channel: Any = None  # from configure to cleanup
        self._trajectories: Any = None  # to a controller that follows them
        self._acts = self._ending = False
        self._seen_at_end = "the controller has not moved the arm"
        self._control_state = ControlStateLayout(len(self._joints))
        # Where the arm waits for commands, how fast they come says nothing about the trial.
        self._timer = None if waits else LoopTimer(control.rate_hz, round(TIMED_S * control.rate_hz))
        self._answered_ns, self._commanding = -1, False

        # Also before it is active: listening does no harm, and tells whether there is an arm.
        self._states = RateMeter()
        # A simulation that goes ahead waits for none of its states in particular.
        profile = qos.EVERYTHING if follows and waits else qos.NEWEST
        states = busy_subscription(self, JointState, topics.JOINT_STATES, self._on_joint_state, profile)
        self.busy_subscriptions, self._states_topic = [states], str(states.topic_name)
        if follows:
            # Late: most arms need no control_msgs.
            from tel_ros.nodes.trajectory.channel import TrajectoryChannel

            self._trajectories = TrajectoryChannel(self, config)
            self.busy_subscriptions.append(self._trajectories.states)
        self.create_timer(0.02, self._watch, clock=STEADY)
        self._competing = CompetingPublishers(self, topics.commands(arm))
        self._ready = Bool()
        self._ready_pub = self.create_publisher(Bool, topics.private(topics.READY), qos.LATCHED)
        self._ready_pub.publish(self._ready)
        self.create_timer(0.1, self._publish_ready, clock=STEADY)
        self._trials = TrialServer(self, self._joints, lambda: self._controller, self._obstacle, self._timer)
        self._safety = SafetyServices(self, lambda: self._controller, self._why_not_reset)
        self.serve = self._safety.serve
        self._diagnostics = Diagnostics(self, "control loop", arm.name, self._health)
        # The first line that a process logs takes rclpy tens of milliseconds (it goes through all modules for
        # the caller): now, not in the first tick of a trial.
        self.get_logger().info("waits to be configured and activated")
        apply_realtime_options(self, control)

    def configure(self) -> None:
        """Make the publishers; the channel of the commands is shut."""
        # In this order: who hears the states of the controller then has the connection for its commands, too.
        self._channel = self._trajectories or CommandChannel(self, self._interface)
        self._state_pub = self.create_publisher(
            ControlState, topics.private(topics.CONTROL_STATES), qos.STREAM
        )

    def activate(self) -> None:
        """Open the channel, unless an emergency stop is latched."""
        if self._safety.reason:
            raise TransitionRefusedError(f"{self._safety.reason}; call {self._safety.reset_name} first")
        self._channel.open(self._controller.commands)
        self._acts = True

    def deactivate(self) -> None:
        """Release an arm that is held, or leave it so (``safety.final_effort``); not while it moves."""
        stop = self._safety.stop_name
        if self._trials.busy:
            why = f"a trial is under way; cancel it, or call {stop}, and wait for its end"
            raise TransitionRefusedError(why)
        if self._arm.moves:
            raise TransitionRefusedError(f"the arm moves; wait until it rests, or call {stop}")
        self._release(hold=self._holds_at_the_end)

    def cleanup(self) -> None:
        """Take the publishers back."""
        self._channel.destroy()
        self._channel = None
        self.destroy_publisher(self._state_pub)

    def shutdown(self) -> None:
        """Bring a moving arm to rest, then release it: a shutdown cannot be refused."""
        self.stop()

    def give_up(self) -> None:
        """Release the arm and begin anew: what the failed transition has done is unknown."""
        self._controller.lose_states("a transition of the node failed")
        self._trials.finish()
        self._release(hold=False)
        if self._channel is not None:
            self.cleanup()

    def stop(self) -> None:
        """Bring a moving arm to rest, and then to what ``safety.final_effort`` says."""
        self._ending = True
        self._controller.finish()
        self._end_if_stopped()

    @property
    def stopped(self) -> bool:
        """Whether the last effort has been commanded, or no states come to answer."""
        if not self._acts or self._controller.at_final_effort:
            return True
        return not self._controller.active and not self._arm.is_fresh

    def destroy_node(self) -> None:
        """Command the last effort, then go."""
        self._release(hold=self._holds_at_the_end and self._controller.at_final_effort)
        self.get_logger().info(f"{ENDED}{self._seen_at_end}")
        self._trials.destroy()
        super().destroy_node()

    def _on_joint_state(self, raw: bytes) -> None:
        arrived_ns = time.monotonic_ns()
        if self._competing.of_states:
            return  # several publishers: nobody knows whose state it is
        try:
            state = self._gate.admit(*self._read(raw), arrived_ns)
        except StateError as error:
            self.get_logger().error(f"{error}; it is ignored", throttle_duration_sec=COMPLAINT_PERIOD_S)
            self._arm.hear(None, False, str(error))
            self._end_in_silence()
            return
        if self._gate.estimated != self._estimated:
            self._say_what_is_estimated()
        is_new = state is not self._arm.state
        counts = is_new or not self._controller.active
        self._arm.hear(state, counts, "the joint states repeat their stamp")
        if not counts:
            self._end_in_silence()
        if self._acts:
            self._act_on(state, arrived_ns)
        if is_new:  # the command is on its way: the arm does not wait for this
            self._states.count += 1
            self._arm.settle()

    def _act_on(self, state: ArmState, arrived_ns: int) -> None:
        moves = self._controller.active or self._controller.braking or self._is_stopping()
        if not (moves or self._answers_between_trials):
            self._commanding = False
        elif state.time_ns != self._answered_ns:
            self._answer(state, arrived_ns)
        elif not self._answers_between_trials or self._controller.active:
            # A waiting arm repeats its state until it gets the answer.
            self._channel.repeat()

    def _say_what_is_estimated(self) -> None:
        self._estimated = self._gate.estimated
        if self._estimated:
            self.get_logger().warning(
                f"the joint states have no velocity for {', '.join(self._estimated)}: "
                "it is estimated from the positions (control.velocity_filter_hz)"
            )
        else:
            self.get_logger().info("the joint states have all velocities now: none is estimated")

    def _answer(self, state: ArmState, arrived_ns: int) -> None:
        goal = self._controller.goal
        tick = self._controller.decide(state)
        self._commanding = tick is not None
        if tick is not None:
            self._answered_ns = state.time_ns
            self._channel.send(state.time_ns)
            # The command is on its way: the arm does not wait for the rest.
            if goal and self._timer is not None:
                self._timer.add(state.time_ns, arrived_ns, time.monotonic_ns())
            self._controller.conclude(state, tick)
            self._state_pub.publish(self._control_state.packed(goal.index if goal else 0, state, tick))
        if self._controller.braking:
            self._tell_ready()
        self._trials.finish()
        self._end_if_stopped()

    def _is_stopping(self) -> bool:
        """Whether a stopped arm is on its way to its final effort, or moves.

        In lockstep the time of an arm that gets no answer stands still: it would never be seen at rest.
        """
        stopped = self._controller.stopped_for is not None
        return stopped and (not self._controller.at_final_effort or self._arm.moves)

    def _why_not_reset(self) -> str:
        if self._ending:
            return "the node is ending"
        return "the arm is not at rest yet" if self._is_stopping() or self._arm.moves else ""

    def _end_if_stopped(self) -> None:
        if self._ending and self.stopped:
            self._release(hold=self._holds_at_the_end and self._controller.at_final_effort)

    def _publish_zero(self) -> None:
        self._commanding = False
        self._controller.safety.none()
        if self._interface == "effort":  # zeros would be a posture, and position drives hold their last one
            self._channel.send(self._arm.state.time_ns if self._arm.state else 0)

    def _release(self, hold: bool) -> None:
        """Shut the channel, after a last command of zero effort unless the last one is to stay."""
        if not self._acts:
            return
        self._seen_at_end = self._arm.last_words(self._controller)
        if self._controller.safety.last_nm.any() and not hold:
            self._publish_zero()
        self._channel.shut()
        self._acts = self._commanding = False
        # The next controller knows nothing of what this one held. A stop outlives it.
        self._controller = self._make_controller()
        if self._safety.reason:
            self._controller.stop_for(self._safety.reason)

    def _watch(self) -> None:
        """End what is under way when other nodes command the arm or publish its states, or states stop."""
        self._competing.look()
        if self._competing.of_states and (self._commanding or self._controller.active):
            self._lose_states(self._competing.of_states)
        elif self._competing.of_commands:
            self._controller.abort(self._competing.of_commands)
        self._end_in_silence()

    def _end_in_silence(self) -> None:
        """End what is under way if no new state has come in time, or the next look would be too late."""
        if self._arm.age_s > self._silence_s and (self._commanding or self._controller.active):
            self._lose_states(self._arm.silence())

    def _lose_states(self, message: str) -> None:
        self.get_logger().error(f"{message}: {LEFT[self._interface]}")
        self._controller.lose_states(message)
        self._publish_zero()
        self._tell_ready()  # before the trial's end is told: what asks for the next one waits for it
        self._trials.finish()
        self._end_if_stopped()

    def _obstacle(self) -> str:
        """Why no trial can begin now, apart from what the arm does; empty: one can."""
        if self._ending:
            return "the node is ending"
        if not self._acts:
            return (
                f"{self.get_name()} is {self.lifecycle_state}; expected active "
                f"(ros2 lifecycle set {self.get_fully_qualified_name()} configure, then activate)"
            )
        if not self._arm.is_fresh:
            return f"no joint states on {self._states_topic}"
        unheard = "" if self._channel.listeners else f"nobody listens to {self._channel.topic}"
        return self._competing.of_states or self._competing.of_commands or unheard or self._channel.problem

    def _tell_ready(self) -> None:
        ready = not (self._obstacle() or self._controller.braking)
        if ready != self._ready.data:
            self._ready.data = ready
            self._ready_pub.publish(self._ready)

    def _publish_ready(self) -> None:
        self._tell_ready()
        if self._acts and self._arm.is_fresh and not self._commanding:
            self._state_pub.publish(idle_state(self._arm.state))

    def _health(self) -> Health:
        """Return the worst that is known, and all values."""
        trial = self._controller.goal.index if self._controller.goal else 0
        phase, stopped, last = self._controller.phase.name, self._safety.reason, self._trials.last
        listeners = self._channel.listeners if self._channel else 0
        ended = f"trial {last.index}: {last.outcome.name}" if last else "none"
        ended += f": {last.message}" if last and last.message else ""
        found = (
            (stopped, Level.ERROR, f"{stopped}; {self._safety.reset_name} ends it"),
            (self.lifecycle_state != "active", Level.WARN, f"{self.lifecycle_state}: it commands nothing"),
            (not self._arm.is_fresh, Level.ERROR, f"no joint states on {self._states_topic}"),
            (listeners == 0, Level.ERROR, f"nobody listens to {self._competing.command_topic}"),
            (trial, Level.OK, f"trial {trial}: {phase}"),
            (last and last.outcome == Outcome.ABORTED, Level.WARN, f"{ended}; {phase}"),
            (True, Level.OK, phase),
        )
        level, message = next((level, message) for holds, level, message in found if holds)
        values: dict[str, object] = {
            "lifecycle": self.lifecycle_state,
            "phase": phase,
            "trial": trial or "none",
            "emergency_stop": stopped or "not latched",
            "states_rate_hz": f"{self._states.rate_hz():.1f}",
            "states_age_s": f"{self._arm.age_s:.3f}",
            "listeners_to_commands": listeners,
            "last_refusal": self.refusal or "none",
            "last_trial": ended,
        }
        return Health(level, message, values)


main = partial(run_node, EpControllerNode)

if __name__ == "__main__":
    main()
