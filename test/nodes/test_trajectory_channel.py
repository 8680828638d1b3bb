"""Trials as goals of a controller that does as it likes: the stand-in's law, with an arm in formulas."""

from __future__ import annotations

import threading
from types import SimpleNamespace
from typing import Any
from unittest.mock import MagicMock

import numpy as np
import pytest
from action_msgs.msg import GoalStatus
from rcl_interfaces.msg import ParameterValue
from rclpy.parameter import Parameter
from rclpy.task import Future
from two_link import TwoLinkArm, arm_config, reach

from sim_bridge.splines import points_of
from sim_bridge.trajectory_control import End, Gains, Tolerances, TrajectoryController
from tel_ros.core.arm_state import ArmState
from tel_ros.core.config import Config, ControlConfig
from tel_ros.core.control.observed import ObservedController
from tel_ros.core.control.trajectory_points import TrajectoryPoints
from tel_ros.core.trial import Outcome, Phase, TrialReport
from tel_ros.core.types import NS_PER_S
from tel_ros.nodes.trajectory import channel as module
from tel_ros.nodes.trajectory.channel import ANSWER_TIMEOUT_S, TrajectoryChannel
from tel_ros.recording.cdr import ControllerStateLayout

PERIOD_NS = 2_000_000
STIFF = 15.0
SILENT = "joint_trajectory_controller has not answered for 0.25 s"


class Follower:
    """The controller of the arm, in place of the client that asks it. Times are those of the arm."""

    def __init__(self) -> None:
        self.arm = arm_config(command_interface="trajectory")
        self.law = TrajectoryController(self.arm.joints, 500.0, self.gains())
        self.there, self.accepts, self.answers, self.obeys, self.tells = True, True, True, True, True
        self.goals: list[Any] = []
        self.cancelled = 0
        self._result: Future = Future()

    def gains(self, p: float = STIFF) -> Gains:
        """Return the arm's own, but for p."""
        return Gains(np.full(2, p), np.zeros(2), np.full(2, 1.5), np.zeros(2))

    def server_is_ready(self) -> bool:
        return self.there

    def send_goal_async(self, goal: Any) -> Future:
        self.goals.append(goal)
        answer = Future()
        if self.answers:
            self._result = Future()
            answer.set_result(self._handle(self._result))
        if self.answers and self.accepts:
            tolerances = Tolerances.of((0, 0), (0, 0), 0.0, 0.0).asked_for(goal, self.arm.joints)
            self.law.follow(points_of(goal.trajectory, self.arm.joints, self.law.time_ns or 0), tolerances)
        return answer

    def _handle(self, result: Future) -> SimpleNamespace:
        return SimpleNamespace(
            accepted=self.accepts, get_result_async=lambda: result, cancel_goal_async=self.cancel
        )

    def cancel(self) -> Future:
        self.cancelled += 1
        answer = Future()
        if self.obeys:
            self.end(self.law.cancel(), GoalStatus.STATUS_CANCELED)
            answer.set_result(None)
        return answer

    def end(self, end: End, status: int | None = None) -> None:
        """Tell the end of the goal."""
        status = status or (GoalStatus.STATUS_ABORTED if end.code else GoalStatus.STATUS_SUCCEEDED)
        result = SimpleNamespace(error_code=int(end.code), error_string=end.text)
        self._result.set_result(SimpleNamespace(status=status, result=result))


class Bench:
    """An arm, its controller, and the channel of a trial to it."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, **control: Any) -> None:
        self.follower = follower = Follower()
        self.time_ns = NS_PER_S
        monkeypatch.setattr(module, "ActionClient", lambda *_: follower)
        monkeypatch.setattr(module, "busy_subscription", MagicMock())
        monkeypatch.setattr(module.time, "monotonic", lambda: self.time_ns / NS_PER_S)
        settings = ControlConfig(**control)
        config = MagicMock(spec=Config, arm=follower.arm, control=settings, arm_waits_for_commands=False)
        self.parameters, self.log = Future(), MagicMock()
        node = MagicMock()
        node.get_logger.return_value = self.log
        node.create_client.return_value.call_async.return_value = self.parameters
        self.channel = TrajectoryChannel(node, config)
        self.controller = ObservedController(follower.arm, settings)
        self.channel.open(self.controller)
        self.arm, self._layout = TwoLinkArm(), ControllerStateLayout(follower.arm.joints)

    def step(self) -> None:
        """Let one period pass."""
        law, follower = self.follower.law, self.follower
        state = ArmState(self.time_ns, np.array(self.arm.q), np.array(self.arm.v))
        if end := law.update(self.time_ns, self.arm.q, self.arm.v):
            follower.end(end)
        if follower.tells:
            rows = *law.desired[:3], *law.measured, *law.error, law.effort_nm
            self.channel._on_state(
                self._layout.packed(
                    self.time_ns, self.time_ns - law.start_ns, *(row.tolist() for row in rows)
                )
            )
        if (tick := self.controller.decide(state)) is not None:
            self.channel.send(self.time_ns)
            self.controller.conclude(state, tick)
        self.arm.step(law.effort_nm, PERIOD_NS / NS_PER_S)
        self.time_ns += PERIOD_NS

    def until(self, condition: Any, limit_s: float = 30.0) -> None:
        """Go on until something is so."""
        end_ns = self.time_ns + round(limit_s * NS_PER_S)
        while not condition():
            assert self.time_ns < end_ns, f"still {self.controller.phase.name} after {limit_s} s"
            self.step()

    def start(self, phase: Phase = Phase.APPROACH, duration_s: float = 1.0) -> None:
        """Begin a trial, and go on to the middle of a phase of it."""
        self.controller.start(reach(start=(0.7, 1.2), duration_s=duration_s))
        self.until(lambda: self.controller.phase is phase)
        for _ in range(100):
            self.step()

    def end(self) -> TrialReport:
        """Go on to the end of the trial."""
        self.until(lambda: not self.controller.active)
        assert self.controller.report is not None
        return self.controller.report


@pytest.fixture
def bench(monkeypatch: pytest.MonkeyPatch) -> Bench:
    return Bench(monkeypatch)


def test_a_trial_is_two_goals_and_what_the_controller_is_believed_to_do_is_what_it_does(bench: Bench) -> None:
    commanded, believed = [], []
    bench.controller.start(reach(start=(0.7, 1.2)))
    while bench.controller.active:
        bench.step()
        if bench.controller.phase is Phase.RUN:
            commanded.append(bench.follower.law.effort_nm)
            believed.append(bench.controller.safety.last_nm)
    report = bench.controller.report
    assert report is not None
    assert (report.outcome, report.message) == (Outcome.COMPLETED, "")
    approach, movement = bench.follower.goals
    assert [each.position for each in movement.path_tolerance] == [1.0, 1.0]
    assert approach.trajectory.points[0].positions == pytest.approx([0.6, 1.3])
    # In the periods in which it takes up a goal it knows nothing of the one that follows.
    np.testing.assert_allclose(commanded[2:-2], believed[2:-2], atol=2e-3)


def test_states_are_answered_while_a_long_movement_is_made(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    made, make = threading.Event(), bench.controller.movement_points

    def slowly(rest_ns: int) -> TrajectoryPoints:
        assert made.wait(30.0)
        return make(rest_ns)

    monkeypatch.setattr(bench.controller, "movement_points", slowly)
    bench.start()
    bench.until(lambda: bench.controller.settled)
    for _ in range(200):
        bench.step()
    assert bench.controller.settled and len(bench.follower.goals) == 1
    made.set()
    bench.until(lambda: len(bench.follower.goals) == 2)
    bench.until(lambda: bench.controller.report is not None)
    assert bench.controller.report.outcome == Outcome.COMPLETED


def test_a_movement_begins_without_a_jump_where_the_arm_does_not_rest_at_its_start(bench: Bench) -> None:
    bench.arm.push = lambda time_s: (3.0, 0.0)  # a weight
    bench.start(Phase.SETTLE)
    efforts = []
    while bench.controller.time_from_start_s < 0.05:
        bench.step()
        efforts.append(bench.follower.law.effort_nm)
    assert len(bench.follower.goals) == 2
    steps_nm = np.abs(np.diff(efforts, axis=0))
    assert steps_nm.max() < 0.1


def test_a_cancelled_trial_cancels_the_goal_and_tells_what_came_of_it(bench: Bench) -> None:
    bench.start(Phase.RUN)
    bench.controller.cancel()
    bench.step()
    assert bench.follower.cancelled == 1
    assert bench.follower.law.holding
    report = bench.end()
    assert (report.outcome, report.message) == (Outcome.CANCELLED, "cancelled")
    assert bench.follower.cancelled == 1


def test_a_cancellation_that_nobody_answers_is_asked_for_again_and_said(bench: Bench) -> None:
    bench.start(Phase.RUN, duration_s=8.0)
    bench.follower.obeys = False
    bench.controller.cancel()
    bench.until(lambda: bench.follower.cancelled == 2)
    bench.log.error.assert_called_with(SILENT)
    bench.follower.obeys = True
    bench.until(lambda: bench.follower.law.holding)
    assert bench.follower.cancelled == 3
    bench.end()


@pytest.mark.parametrize(
    ("fault", "message"),
    [
        ({"accepts": False}, "joint_trajectory_controller has rejected the goal; its log says why"),
        ({"answers": False}, SILENT),
    ],
)
def test_a_controller_that_takes_no_goal_ends_the_trial(
    bench: Bench, fault: dict[str, bool], message: str
) -> None:
    vars(bench.follower).update(fault)
    begun_ns = bench.time_ns
    bench.start(Phase.STOP)
    assert (bench.time_ns - begun_ns) / NS_PER_S < ANSWER_TIMEOUT_S + 0.5
    report = bench.end()
    assert (report.outcome, report.message) == (Outcome.ABORTED, message)


def test_a_movement_that_is_not_accepted_before_it_should_begin_is_given_up(bench: Bench) -> None:
    bench.start(Phase.SETTLE)
    bench.follower.answers = False
    report = bench.end()
    assert report.message == "joint_trajectory_controller has not accepted the movement before its beginning"
    assert bench.controller.course.score.ticks <= 1


def test_a_controller_that_falls_silent_ends_the_trial_and_is_cancelled(bench: Bench) -> None:
    bench.start(Phase.RUN, duration_s=4.0)
    bench.follower.tells = False
    report = bench.end()
    assert report.message.startswith(
        "joint_trajectory_controller has said nothing on its controller_state for 0.5"
    )
    assert bench.follower.cancelled == 1


def test_what_ends_a_goal_elsewhere_ends_the_trial(bench: Bench) -> None:
    bench.start(Phase.RUN)
    bench.follower.cancel()
    assert bench.end().message == "joint_trajectory_controller: the goal was cancelled by somebody else"


def test_a_path_that_the_controller_finds_left_ends_the_trial_with_its_words(bench: Bench) -> None:
    bench.start(Phase.RUN)
    bench.follower.law._tolerances.path[0, 1] = 1e-9
    message = "joint_trajectory_controller: Aborted due to path tolerance violation (error -4)"
    assert bench.end().message == message


def test_gains_that_change_in_a_trial_are_seen_in_the_commands(bench: Bench) -> None:
    bench.arm.push = lambda time_s: (7.0, 0.0)
    bench.start(Phase.RUN, duration_s=4.0)
    bench.follower.law.gains = bench.follower.gains(p=60.0)
    message = bench.end().message
    assert "its gains or its trajectory are not those of this run" in message
    assert message.startswith("joint_trajectory_controller commands ")


def values(bench: Bench, **changed: Any) -> SimpleNamespace:
    """Return the answer of a controller that is set up as it should be, but for some values."""
    expected = bench.channel._expected() | {name.replace("__", "."): v for name, v in changed.items()}
    found = [Parameter(name, value=v).get_parameter_value() for name, v in expected.items()]
    return SimpleNamespace(values=found)


def test_before_a_trial_the_controller_has_to_tell_its_gains(bench: Bench) -> None:
    assert bench.channel.problem == "joint_trajectory_controller has not told its gains yet"
    bench.parameters.set_result(values(bench))
    assert bench.channel.problem == ""


@pytest.mark.parametrize(
    ("name", "value", "said"),
    [
        ("gains.elbow.p", 14.0, "gains.elbow.p is 14.0; expected 15.0"),
        ("gains.elbow.i", 0.1, "gains.elbow.i is 0.1; expected 0.0"),
        ("gains.shoulder.ff_velocity_scale", 1.0, "gains.shoulder.ff_velocity_scale is 1.0; expected 0.0"),
        ("command_interfaces", ["position"], r"command_interfaces is ['position']; expected ['effort']"),
    ],
)
def test_other_gains_than_those_of_practice_are_refused(
    bench: Bench, name: str, value: Any, said: str
) -> None:
    bench.channel.problem  # noqa: B018
    bench.parameters.set_result(values(bench, **{name: value}))
    assert bench.channel.problem == f"joint_trajectory_controller: {said}, as the arm is configured"


@pytest.mark.parametrize("answers", [False, True])
def test_gains_that_nobody_tells_are_no_obstacle_but_a_warning(bench: Bench, answers: bool) -> None:
    assert bench.channel.problem
    if answers:
        bench.parameters.set_result(SimpleNamespace(values=[ParameterValue()]))
    assert bench.channel.problem
    bench.time_ns += 2 * NS_PER_S
    assert bench.channel.problem == ""
    (said,) = bench.log.warning.call_args.args
    assert said.endswith("whether its gains are K and B is not known")
