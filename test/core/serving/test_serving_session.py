"""How fast a trajectory is run in service, and what becomes of the network."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import pytest
from two_link import ARM

from tel_ros.core.config import ArmConfig, Config, PathConfig, ServeConfig
from tel_ros.core.errors import NetworkFileError, TrainingError
from tel_ros.core.learning.learner import TrainingOutcome
from tel_ros.core.practice.session import CommandedTrial, Prediction
from tel_ros.core.serving.memory import ServiceMemory
from tel_ros.core.serving.reference import Points, RefusedError
from tel_ros.core.serving.session import Served, ServingSession
from tel_ros.core.trajectories.trajectory import DesiredTrajectory
from tel_ros.core.trial import Outcome, TrialReport
from tel_ros.core.types import NS_PER_S

HERE = np.array([0.0, 0.0])
THERE = Points(np.array([NS_PER_S]), np.array([[0.5, 0.5]]))


@dataclass
class Cell:
    """An arm, a network and a disk: the standard deviation goes with the acceleration.

    ``knows``: how much of the acceleration it leaves unsure, by number of the execution; None: nothing.
    """

    error_rad: float = 1e-3
    outcome: Outcome = Outcome.COMPLETED
    effort_rad: float = 0.0
    """Offset û - y that it predicts."""
    knows: dict[int, float | None] = field(default_factory=lambda: {0: None})
    current: float | None = None
    learns: float = 1e-4
    broken: set[int] = field(default_factory=set)
    memory: ServiceMemory | None = None
    executed: list[CommandedTrial] = field(default_factory=list)
    refuses_to_learn: str = ""
    loaded: list[int] = field(default_factory=list)

    def execute(self, commanded: CommandedTrial) -> tuple[TrialReport, str]:
        self.executed.append(commanded)
        goal = commanded.goal
        return TrialReport(
            index=goal.index,
            alpha=goal.alpha,
            duration_s=goal.desired.duration_s,
            outcome=self.outcome,
            message="",
            rms_error_rad=self.error_rad,
            rms_error_per_joint_rad=np.full(2, self.error_rad),
            max_error_rad=3 * self.error_rad,
            max_effort_nm=np.zeros(2),
            saturated_ratio=0.0,
            run_ns=1,
        ), f"bag {goal.index}"

    def predict(self, desired: DesiredTrajectory) -> Prediction:
        acceleration = np.sqrt(np.mean(desired.acceleration_rad_s2**2))
        std = math.inf if self.current is None else self.current * acceleration
        return Prediction(desired.position_rad + self.effort_rad, np.full(desired.position_rad.shape, std))

    def train(self, trial: str) -> TrainingOutcome:
        if self.refuses_to_learn:
            raise TrainingError(self.refuses_to_learn)
        self.current = self.learns
        return TrainingOutcome(0.1, 0.01, 0.1, ())

    def save(self, index: int) -> None:
        self.knows[index] = self.current

    def load(self, index: int) -> None:
        if index in self.broken or index not in self.knows:
            raise NetworkFileError(f"after_{index:03d}.npz", "not readable", "a network")
        self.loaded.append(index)
        self.current = self.knows[index]

    def keep(self, memory: ServiceMemory) -> None:
        self.memory = memory

    def networks(self) -> list[int]:
        return sorted(self.knows)[-10:]


def session_of(cell: Cell, memory: ServiceMemory | None = None, **serve: Any) -> ServingSession[str]:
    config = Config(
        arm=ArmConfig(**ARM),  # type: ignore[arg-type]
        path=PathConfig(name="planar_loops"),
        serve=ServeConfig(**serve),
    )
    return ServingSession(config, cell, cell, cell, memory or ServiceMemory())


def served(session: ServingSession[str], points: Points = THERE) -> Served[str]:
    return session.execute(session.decide(points, HERE))


def test_what_nothing_is_known_of_runs_slowest_and_what_is_known_well_as_requested() -> None:
    cell = Cell(learns=1e-4)
    session = session_of(cell, most_slowdown=3.0)
    first, second = served(session), served(session)
    assert first.decision.slowdown == 3.0
    assert "3.00 times slower than requested: nothing has been learned" in first.text
    assert (second.decision.slowdown, second.decision.said) == (1.0, "")
    assert cell.executed[0].goal.desired.duration_s == pytest.approx(3.0, abs=0.01)
    assert cell.executed[1].goal.desired.duration_s == pytest.approx(1.0, abs=0.01)


def test_it_is_slowed_down_by_no_more_than_it_takes_to_be_sure() -> None:
    cell = Cell(current=4e-3, knows={0: 4e-3})
    decision = session_of(cell).decide(THERE, HERE)
    assert 1.0 < decision.slowdown < 4.0
    assert decision.expected_rad == pytest.approx(5e-3, rel=0.1)
    assert decision.expected_rad <= 5e-3
    assert "were expected at the requested speed" in decision.said


def test_errors_larger_than_expected_make_it_more_careful_with_other_movements() -> None:
    cell = Cell(current=1e-3, knows={0: 1e-3}, learns=1e-3, error_rad=0.02)
    session = session_of(cell)
    other = Points(THERE.time_ns, -THERE.position_rad)
    assert session.decide(other, HERE).slowdown == 1.0
    served(session)
    assert session.decide(other, HERE).slowdown > 1.5


def test_where_it_may_not_slow_down_it_runs_as_requested_or_refuses() -> None:
    cell = Cell()
    session = session_of(cell, may_slow_down=False)
    with pytest.raises(RefusedError, match=r"nothing has been learned.*serve\.may_slow_down is false"):
        session.decide(THERE, HERE)
    cell.knows[0] = 1e-4
    assert session.decide(THERE, HERE).slowdown == 1.0
    assert cell.executed == []


@pytest.mark.parametrize(
    ("points", "said"),
    [
        (Points(np.array([0, NS_PER_S]), np.array([[0.2, 0.0], [0.5, 0.5]])), "shoulder is at 0.000 rad"),
        (Points(np.array([NS_PER_S]), np.array([[0.5, 3.5]])), "elbow should be at"),
        (Points(np.array([NS_PER_S // 100]), np.array([[0.5, 0.5]])), "rad/s"),
        (Points(np.array([0]), np.array([[0.0, 0.0]])), "ends at 0 s"),
    ],
)
def test_what_the_arm_must_not_follow_is_refused_with_the_reason(points: Points, said: str) -> None:
    cell = Cell(knows={0: 1e-5})
    with pytest.raises(RefusedError, match=said):
        session_of(cell).decide(points, HERE)


def test_a_speed_that_is_known_to_need_too_much_effort_is_refused() -> None:
    cell = Cell(knows={0: 1e-4}, effort_rad=2.0)  # 30 N·m
    with pytest.raises(RefusedError, match=r"too fast: \w+ would need 3\d\.\d of 20 N·m"):
        session_of(cell).decide(THERE, HERE)


@pytest.mark.parametrize("outcome", [Outcome.ABORTED, Outcome.CANCELLED])
def test_nothing_is_learned_from_an_execution_that_was_not_completed(outcome: Outcome) -> None:
    cell = Cell(outcome=outcome)
    session = session_of(cell)
    done = served(session)
    assert (done.training, list(cell.knows), session.memory.network) == (None, [0], 0)
    assert "nothing was learned" in done.text


def test_after_an_abort_the_movement_is_slower_and_then_by_and_by_as_before() -> None:
    cell = Cell(knows={0: 1e-4})
    session = session_of(cell)
    cell.outcome = Outcome.ABORTED
    assert served(session).decision.slowdown == 1.0
    cell.outcome = Outcome.COMPLETED
    slowdowns = [served(session).decision.slowdown for _ in range(5)]
    assert slowdowns[0] == pytest.approx(math.sqrt(2.0))
    assert slowdowns == sorted(slowdowns, reverse=True)
    assert slowdowns[-1] == 1.0


def test_an_execution_clearly_worse_than_before_takes_back_the_network_of_before() -> None:
    cell = Cell(knows={0: 1e-4})
    session = session_of(cell)
    served(session)  # with 0
    served(session)  # with 1
    assert session.memory.network == 2
    cell.error_rad = 0.01
    worse = served(session)
    assert worse.training is None
    assert session.memory.network == 1  # as good as the first, and newer
    assert "the network of before is taken back" in worse.text
    # With that network it comes out as badly: the arm has changed, and is learned anew.
    again = served(session)
    assert again.training is not None
    assert session.memory.network == again.report.index
    cell.error_rad = 0.011
    assert served(session).training is not None


def test_an_error_within_the_tolerance_takes_nothing_back() -> None:
    cell = Cell(knows={0: 1e-4}, error_rad=1e-4)
    session = session_of(cell)
    served(session), served(session)
    cell.error_rad = 4e-3
    assert served(session).training is not None


def test_a_broken_network_file_costs_what_was_learned_since_the_one_before() -> None:
    cell = Cell()
    session = session_of(cell)
    served(session), served(session)
    cell.broken = {2}
    decision = session.decide(THERE, HERE)
    assert session.memory.network == 1
    assert "after_002.npz: not readable" in decision.said
    cell.broken = set(cell.knows)
    with pytest.raises(RefusedError, match="no network can be loaded"):
        session.decide(THERE, HERE)


def test_what_cannot_be_learned_from_is_told_and_the_movement_counts() -> None:
    cell = Cell(refuses_to_learn="all clipped")
    session = session_of(cell)
    assert "nothing was learned: all clipped" in served(session).text
    assert session.memory.executions == 1


def test_a_service_that_is_restarted_has_what_it_had() -> None:
    cell = Cell()
    session = session_of(cell)
    served(session), served(session)
    assert cell.memory == session.memory
    memory = ServiceMemory.from_plain(json.loads(json.dumps(cell.memory.to_plain(), allow_nan=False)))
    assert memory == session.memory
    restarted = session_of(cell, memory)
    decision = restarted.decide(THERE, HERE)
    assert (decision.slowdown, decision.commanded.plan.index, cell.loaded[-1]) == (1.0, 3, 2)


@pytest.mark.parametrize("values", [{}, {"executions": 1, "network": 1, "ratio": math.nan, "movements": {}}])
def test_what_is_no_memory_is_not_taken_for_one(values: dict[str, Any]) -> None:
    with pytest.raises((KeyError, TypeError, ValueError)):
        ServiceMemory.from_plain(values)


def test_only_so_many_movements_are_remembered_those_asked_for_last() -> None:
    cell = Cell(knows={0: 1e-4})
    session = session_of(cell)
    served(session)
    (one,) = session.memory.movements.values()
    session.memory = replace(session.memory, movements={str(k): one for k in range(1000)})
    served(session)
    assert len(session.memory.movements) == 1000
    assert THERE.key in session.memory.movements and "0" not in session.memory.movements
