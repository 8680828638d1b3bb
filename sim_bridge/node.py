"""The simulated arm behind the topics of a stock ros2_control set-up, and nothing more."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING

import tel_ros.nodes  # noqa: F401 - first: whether ROS can start

# isort: split
from builtin_interfaces.msg import Time
from rclpy.node import Node
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray

from sim_bridge.arm import CommandError, SimulatedArm
from sim_bridge.resuming import replay_arm
from sim_bridge.timing import Allowance, Pacer, Stillness
from tel_ros.core.config import ArmConfig
from tel_ros.core.errors import StateError
from tel_ros.core.types import NS_PER_S
from tel_ros.nodes import qos
from tel_ros.nodes.clock import STEADY
from tel_ros.nodes.conversions import command_reader, to_time
from tel_ros.nodes.diagnostics import Diagnostics, Health, Level
from tel_ros.nodes.hot_loop import busy_subscription
from tel_ros.nodes.parameters import declare_resume, load_parameters
from tel_ros.nodes.realtime import apply_realtime_options
from tel_ros.nodes.runner import run_node
from tel_ros.recording import topics
from tel_ros.recording.cdr import CommandNumbers, JointStateLayout, header_stamp_ns

if TYPE_CHECKING:
    from sim_bridge.trajectory_server import TrajectoryServer

REPEAT_PERIOD_S = 0.05
LOCKSTEP_TURN_PERIOD_S = 0.2
WAIT_S, IDLE_S = 0.002, 0.02
"""How long a goal, and how long anything else, may wait while no period may pass."""
TOLD_EVERY = 10
"""Of so many states a client that keeps up with them is told what the controller makes of one."""
REST_SPEED_RAD_S = 0.05
STOP_SILENCE_S = 0.3
LONGEST_STALL_S = 2.0
NOTEWORTHY_STALL_S = 0.02
COMPLAINT_PERIOD_S = 1.0
CLOCK_PERIOD_NS = 10_000_000
RESTS = (
    "what is recorded does not lead to the recorded states: the arm rests where it was last, "
    "and the run will not be equal to one without interruption"
)


class SimBridgeNode(Node):
    """Publishes joint states and takes commands: efforts, or set points of position drives.

    ``realtime``: one period passes for every period of the wall clock, with the newest command. Periods that
    have gone by while the computer stood still pass at once, and one state tells where the arm is then.

    ``lockstep``: one period passes for every command that answers the newest state; the state is repeated
    until one comes. Time stands still meanwhile, for as long as learning takes; but if nothing comes for long
    while the arm moves (:class:`~sim_bridge.timing.Stillness`), this counts as silence.

    On silence the effort goes to zero and the arm coasts, in both; position drives hold the last set point.

    With ``arm.command_interface: trajectory`` a stand-in for the arm's joint_trajectory_controller runs in
    this process and makes the commands (:class:`~sim_bridge.trajectory_server.TrajectoryServer`). Then
    ``lockstep`` means that time passes as fast as it can while there is a trajectory to follow or the arm
    moves, but not faster than a client takes it that says so (:class:`~sim_bridge.timing.Allowance`).
    """

    def __init__(self) -> None:
        super().__init__("sim_bridge")
        config = load_parameters(self, "arm", "control", "sim", "seed")
        self._sim = config.sim
        self._lockstep = config.sim.clock == "lockstep"
        follows = config.arm.command_interface == "trajectory"
        control = config.control
        if follows and config.arm.controller_rate_hz:
            control = replace(control, rate_hz=config.arm.controller_rate_hz)
        self._period_s = 1.0 / control.rate_hz
        new_arm = partial(SimulatedArm, config.arm, config.sim, rate_hz=control.rate_hz, seed=config.seed)
        command_topic = topics.commands(config.arm)
        self._start_ns = 0
        if (run := declare_resume(self)) is None:
            self._arm = new_arm()
        else:
            # Late: an arm that begins anew should not wait for the reader of bags.
            from tel_ros.recording.run_folder import trial_bags
            from tel_ros.recording.trial_bag import read_arm_record

            trials = (read_arm_record(bag, command_topic) for bag in trial_bags(run))
            self._arm, self._start_ns = replay_arm(new_arm, trials)
        if self._lockstep and self._start_ns:
            self.get_logger().warning(RESTS)
        n_joints = len(config.arm.joints)
        self._layout = JointStateLayout(config.arm.joints, (n_joints, n_joints, n_joints))
        self._read_command = command_reader()
        self._command: Sequence[float] | None = None
        self._silent_periods = 0
        self._watchdog_periods = round(config.sim.watchdog_s * control.rate_hz)
        self._oldest_ns = round(config.sim.command_age_limit_s * NS_PER_S)
        self._stepped_at = time.monotonic()
        self._commanded_at = 0.0
        self._coasting = False
        self._stillness = Stillness(control)
        self._on_silence = "effort is zero, the arm coasts"
        if config.arm.command_interface == "position":
            self._on_silence = "the drives hold the last set point"

        self._states = self.create_publisher(JointState, topics.JOINT_STATES, qos.STREAM)
        self._clock_pub, self._clock_due_ns = None, 0
        if config.sim.publish_clock:
            self._clock_pub = self.create_publisher(Clock, topics.CLOCK, qos.STREAM)
        self._controller: TrajectoryServer | None = None
        if follows:
            self._start_controller(config.arm, control.rate_hz)
        else:
            on_command = self._on_command_in_lockstep if self._lockstep else self._on_command
            hear = partial(self._hear, on_command)
            self.busy_subscriptions = [busy_subscription(self, Float64MultiArray, command_topic, hear)]
        apply_realtime_options(self, config.control)
        if self._lockstep and follows:
            self.pace, self.turn_period_s = self, 0.0
            self.create_timer(REPEAT_PERIOD_S, self._look, clock=STEADY)
        elif self._lockstep:
            # While commands keep coming nothing else is urgent, and each turn of it holds the graph up.
            self.turn_period_s = LOCKSTEP_TURN_PERIOD_S
            self.create_timer(REPEAT_PERIOD_S, self._repeat, clock=STEADY)
            self._coast_timer = self.create_timer(self._period_s, self._coast, autostart=False, clock=STEADY)
        else:
            # In this order: if anything comes between, states look older than they are, not from the future.
            self._start_ns = time.time_ns()  # not ROS time: that may be what is published here
            self._pacer = Pacer(self._period_s, time.monotonic(), LONGEST_STALL_S)
            self.pace = self
        self._publish()
        self._diagnostics = Diagnostics(self, "simulation", config.arm.name, self._health)

    def stop(self) -> None:
        """Wait for whoever commands the arm to bring it to rest."""

    @property
    def stopped(self) -> bool:
        """Whether no command has come for a while, or no trajectory is followed."""
        if self._controller is not None:
            return not self._controller.moves
        return time.monotonic() - self._commanded_at > STOP_SILENCE_S

    def destroy_node(self) -> None:
        """End the simulation, then go."""
        self._arm.close()
        super().destroy_node()

    def _start_controller(self, arm: ArmConfig, rate_hz: float) -> None:
        # Late: most arms need no control_msgs.
        from sim_bridge.trajectory_server import TrajectoryServer

        self._stamp_ns = self._start_ns + self._arm.time_ns
        self._controller = TrajectoryServer(
            arm, rate_hz, self.get_namespace(), self._arm.reading(), self._stamp_ns
        )
        self.companions = [self._controller]
        self._allowance = Allowance(self._period_s, self._sim.lockstep_timeout_s, qos.STATES_AHEAD)
        self._has_client, self._idle_s = False, IDLE_S
        self.busy_subscriptions = [busy_subscription(self, Time, topics.PASSED, self._on_passed)]

    def _publish(self) -> None:
        reading = self._arm.reading()
        self._stamp_ns = self._start_ns + reading.time_ns
        _, *arrays = reading
        self._states.publish(self._layout.packed(self._stamp_ns, *arrays))
        if self._clock_pub is not None and self._stamp_ns >= self._clock_due_ns:
            self._clock_pub.publish(Clock(clock=to_time(self._stamp_ns)))
            self._clock_due_ns = self._stamp_ns + CLOCK_PERIOD_NS

    def _hear(self, take: Callable[[CommandNumbers], None], raw: bytes) -> None:
        """Take a command; what is none, or cannot be used, is ignored."""
        try:
            take(self._read_command(raw))
        except (StateError, CommandError) as error:
            self.get_logger().error(f"{error}; it is ignored", throttle_duration_sec=COMPLAINT_PERIOD_S)

    def _fall_silent(self, silence_s: float) -> None:
        self.get_logger().error(f"no command for {silence_s:.3f} s: {self._on_silence}")

    def _health(self) -> Health:
        """Say whether commands come; without them nothing but friction brakes the arm."""
        silent = self._coasting if self._lockstep else self._command is None
        values = {
            "clock": self._sim.clock,
            "arm_time_s": (self._stamp_ns - self._start_ns) / NS_PER_S,
            "silent": silent and self._controller is None,
        }
        if self._controller is not None:
            does = "follows a trajectory" if self._controller.moves else "holds the arm"
            return Health(Level.OK, does, values)
        if not silent:
            return Health(Level.OK, "waits for commands" if self._commanded_at == 0.0 else "runs", values)
        if self._arm.at_rest(REST_SPEED_RAD_S):
            return Health(Level.OK, "no commands: the arm rests", values)
        return Health(Level.ERROR, f"no commands: {self._on_silence}", values)

    # In real time.

    def _on_command(self, command: CommandNumbers) -> None:
        answered_ns = command.answered_ns
        age_ns = 0 if answered_ns is None else self._stamp_ns - answered_ns
        if 0 < self._oldest_ns < age_ns:
            limit = f"(limit {self._sim.command_age_limit_s:g} s)"
            raise CommandError(f"the command answers a state of {age_ns / NS_PER_S:.3f} s ago {limit}")
        if self._silent_periods >= self._watchdog_periods:
            self.get_logger().info("commands arrive")
        self._command, self._silent_periods = command.values, 0
        self._commanded_at = time.monotonic()

    @property
    def deadline_s(self) -> float:
        """When the next period ends."""
        if self._lockstep:
            return time.monotonic() + self._idle_s
        return self._pacer.deadline_s

    def keep(self) -> None:
        """Let the periods pass that have ended, and publish the state after them."""
        if self._lockstep and self._controller is not None:
            return self._go_ahead(self._controller)
        due = self._pacer.due(time.monotonic())
        if not due.periods:
            return
        commanded = self._command is not None or self._controller is not None
        for _ in range(due.periods):
            self._pass_period()
        late_s = (due.periods - 1) * self._period_s + due.skipped_s
        if commanded and late_s >= NOTEWORTHY_STALL_S:
            self.get_logger().warning(
                f"the simulation stood still for {late_s:.3f} s; the arm has moved on meanwhile"
                + (f", but for {due.skipped_s:.3f} s of it" if due.skipped_s else ""),
                throttle_duration_sec=COMPLAINT_PERIOD_S,
            )
        self._start_ns += round(due.skipped_s * NS_PER_S)
        if self._controller is None:
            self._publish()

    def _pass_period(self) -> None:
        if self._controller is not None:
            return self._follow(self._controller)
        if self._command is None:
            self._arm.coast()
            return
        self._silent_periods += 1
        if self._silent_periods >= self._watchdog_periods:
            self._fall_silent(self._sim.watchdog_s)
            self._command = None
            return self._arm.coast()
        self._step(self._command)

    def _step(self, command: Sequence[float]) -> None:
        try:
            self._arm.step(command)
        except CommandError as error:
            self.get_logger().error(f"{error}; it is ignored", throttle_duration_sec=COMPLAINT_PERIOD_S)
            self._arm.coast()

    # In lockstep.

    def _on_command_in_lockstep(self, command: CommandNumbers) -> None:
        answered_ns = command.answered_ns
        if answered_ns is not None and answered_ns != self._stamp_ns:
            return  # the answer to a repetition of a state that has been answered before
        self._arm.step(command.values)
        if self._coasting:
            self.get_logger().info("commands arrive")
            self._coasting = False
            self._coast_timer.cancel()
        self._stepped_at = self._commanded_at = time.monotonic()
        self._publish()
        self._stillness.add(self._arm.reading().position_rad)

    def _repeat(self) -> None:
        silence_s = time.monotonic() - self._stepped_at
        if self._coasting or silence_s < REPEAT_PERIOD_S:
            return
        if silence_s > self._sim.lockstep_timeout_s and not self._stillness.stands_still:
            self._fall_silent(silence_s)
            self._coasting = True
            self._coast_timer.reset()
            return
        self._publish()

    def _coast(self) -> None:
        self._arm.coast()
        self._publish()
        if self._arm.at_rest(REST_SPEED_RAD_S):
            self.get_logger().info("the arm has come to rest")
            self._coasting = False
            self._coast_timer.cancel()

    # With a trajectory controller.

    def _follow(self, controller: TrajectoryServer) -> None:
        """Let a period pass, and tell each state: none is too late for a command."""
        told_every = TOLD_EVERY if self._has_client else 1
        self._step(controller.answer(self._arm.reading(), self._stamp_ns, told_every))
        self._publish()

    def _go_ahead(self, controller: TrajectoryServer) -> None:
        """Let the periods pass that may, in lockstep."""
        busy = controller.moves or not self._stillness.stands_still
        periods = self._allowance.periods(
            self._stamp_ns, time.monotonic(), has_client=self._has_client, busy=busy
        )
        for _ in range(periods):
            self._follow(controller)
            self._stillness.add(self._arm.reading().position_rad)
        self._idle_s = 0.0 if periods else WAIT_S if busy else IDLE_S

    def _on_passed(self, raw: bytes) -> None:
        self._allowance.hear(header_stamp_ns(raw), time.monotonic())

    def _look(self) -> None:
        """See whether there is a client that says how far it is; repeat the state while none passes."""
        self._has_client = self.busy_subscriptions[0].get_publisher_count() > 0
        if self._idle_s:
            self._publish()


main = partial(run_node, SimBridgeNode)

if __name__ == "__main__":
    main()
