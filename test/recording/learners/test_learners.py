"""Learners found by name, those of other packages included, and the one that a run begins with."""

from __future__ import annotations

import dataclasses
import sys
from collections.abc import Callable, Iterator
from importlib.metadata import EntryPoint
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from tel_ros.core import plugins
from tel_ros.core.config import Config
from tel_ros.core.errors import ConfigError, NetworkFileError
from tel_ros.core.learning.learner import LearnerContext, StoredLearner
from tel_ros.core.learning.least_squares_learner import LeastSquaresLearner
from tel_ros.core.learning.lms_learner import LmsLearner
from tel_ros.core.learning.polynomial import PolynomialLearner
from tel_ros.core.learning.registry import GROUP, learner_kind
from tel_ros.core.learning.rigid_body import RigidBodyLearner
from tel_ros.recording.network_file import learner_context, load_network, new_network, save_network

OURS = ("lms_tree", "polynomial", "rigid_body", "rigid_body+lms_tree")


class TheirLearner(LmsLearner):
    """A learner of somebody's own package."""


class TheirKind:
    """What their entry point names."""

    def new(self, context: LearnerContext) -> TheirLearner:
        return TheirLearner(context)

    def restored(self, context: LearnerContext, stored: StoredLearner) -> TheirLearner:
        return TheirLearner.restored(context, stored)


class NeedsMore(TheirKind):
    """A class that cannot be made without being told something."""

    def __init__(self, size: int) -> None:
        self.size = size


class WithoutRestored:
    """It can begin, but not go on."""

    def new(self, context: LearnerContext) -> TheirLearner:
        return TheirLearner(context)


@pytest.fixture(autouse=True)
def nothing_remembered() -> Iterator[None]:
    """Forget which learners have been found, before and after."""
    learner_kind.cache_clear()
    yield
    learner_kind.cache_clear()


@pytest.fixture
def installed(monkeypatch: pytest.MonkeyPatch) -> Callable[..., None]:
    """Pretend that a package with entry points is installed: ``installed(name="module:attribute")``."""
    module = ModuleType("their_package")
    module.Kind, module.kind, module.Odd = TheirKind, TheirKind(), WithoutRestored
    module.new, module.restored = TheirKind().new, TheirKind().restored
    module.NeedsMore, module.number = NeedsMore, 3
    monkeypatch.setitem(sys.modules, "their_package", module)

    def install(**points: str) -> None:
        def offered(*, group: str) -> list[EntryPoint]:
            assert group == GROUP == "tel_ros.learners"
            return [EntryPoint(name, value, group) for name, value in points.items()]

        monkeypatch.setattr(plugins, "entry_points", offered)

    install()
    return install


def refusal(name: str) -> ConfigError:
    """Check that a name is refused under its key, and return the error."""
    with pytest.raises(ConfigError) as error:
        learner_kind(name)
    assert error.value.key == "learning.name"
    assert error.value.value == name
    assert str(error.value).startswith(f"learning.name is {name!r}; expected ")
    return error.value


@pytest.mark.parametrize("name", OURS)
def test_our_learners_are_found_by_name_whatever_is_installed(
    name: str, installed: Callable[..., None]
) -> None:
    alone = learner_kind(name)
    learner_kind.cache_clear()
    installed(**{name: "their_package:Kind"})
    assert type(learner_kind(name)) is type(alone)


@pytest.mark.parametrize("value", ["their_package:Kind", "their_package:kind", "their_package"])
def test_a_class_an_object_or_a_module_of_another_package_is_found_by_the_name_of_its_entry_point(
    value: str, installed: Callable[..., None], config: Config
) -> None:
    installed(theirs=value, another="nowhere:Kind")
    context = learner_context(config)
    learner = learner_kind("theirs").new(context)
    assert type(learner) is TheirLearner
    assert type(learner_kind("theirs").restored(context, learner.stored())) is TheirLearner


def test_a_learner_of_another_package_runs_and_comes_back_from_its_file(
    installed: Callable[..., None], config: Config, tmp_path: Path
) -> None:
    installed(theirs="their_package:Kind")
    asked = dataclasses.replace(config, learning=dataclasses.replace(config.learning, name="theirs"))
    learner = new_network(asked)
    assert type(learner) is TheirLearner
    save_network(learner, tmp_path / "network.npz")
    assert type(load_network(tmp_path / "network.npz")) is TheirLearner


def test_the_fastest_movement_needs_a_learner_that_knows_what_speed_costs(config: Config) -> None:
    practice = dataclasses.replace(config.practice, strategy="adaptive_extension", goal="fastest")
    fastest = dataclasses.replace(config, practice=practice)
    for name in ("lms_tree", "rigid_body+lms_tree"):
        with pytest.raises(ConfigError, match="expected polynomial or rigid_body, because .*fastest"):
            new_network(with_learning(fastest, name=name))
    assert new_network(with_learning(fastest, name="polynomial")).trials_learned == 0


def test_an_unknown_name_is_refused_with_those_that_there_are(installed: Callable[..., None]) -> None:
    installed(theirs="their_package:Kind")
    expected = refusal("lms_trees").expected
    assert "lms_tree, polynomial, rigid_body, rigid_body+lms_tree, theirs" in expected
    assert "entry point of the group tel_ros.learners" in expected


@pytest.mark.parametrize(
    ("value", "cause"),
    [
        ("no_such_package_at_all:Kind", "No module named 'no_such_package_at_all'"),
        ("their_package:Missing", "has no attribute 'Missing'"),
    ],
)
def test_an_entry_point_that_cannot_be_imported_is_refused_with_the_cause(
    value: str, cause: str, installed: Callable[..., None]
) -> None:
    installed(theirs=value)
    expected = refusal("theirs").expected
    assert f"an entry point that loads ({value}: " in expected
    assert cause in expected


def test_whatever_their_module_raises_on_import_is_told(
    installed: Callable[..., None], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "their_broken_package.py").write_text("raise RuntimeError('no\\n  licence')\n")
    monkeypatch.syspath_prepend(tmp_path)
    installed(theirs="their_broken_package:Kind")
    assert "(their_broken_package:Kind: no licence)" in refusal("theirs").expected


@pytest.mark.parametrize(
    ("value", "missing"),
    [("their_package:Odd", "['restored']"), ("their_package:number", "['new', 'restored']")],
)
def test_an_entry_point_without_its_methods_is_refused_with_what_it_lacks(
    value: str, missing: str, installed: Callable[..., None]
) -> None:
    installed(theirs=value)
    assert refusal("theirs").expected.endswith(f"{value} lacks {missing}")


def test_a_class_that_cannot_be_made_is_refused_by_name(installed: Callable[..., None]) -> None:
    installed(theirs="their_package:NeedsMore")
    assert "their_package:NeedsMore" in refusal("theirs").expected


def test_a_package_that_is_repaired_is_found_without_a_restart(installed: Callable[..., None]) -> None:
    installed(theirs="their_package:Missing")
    refusal("theirs")
    installed(theirs="their_package:Kind")
    assert isinstance(learner_kind("theirs"), TheirKind)


def with_learning(config: Config, **values: object) -> Config:
    return dataclasses.replace(config, learning=dataclasses.replace(config.learning, **values))


@pytest.mark.parametrize(
    ("learning", "kind"),
    [
        ({}, LmsLearner),
        ({"weights": "least_squares"}, LeastSquaresLearner),
        ({"name": "polynomial"}, PolynomialLearner),
        ({"name": "rigid_body"}, RigidBodyLearner),
        ({"name": "rigid_body+lms_tree"}, LeastSquaresLearner),
    ],
    ids=str,
)
def test_a_run_begins_with_the_learner_that_its_configuration_asks_for(
    config: Config, learning: dict[str, object], kind: type
) -> None:
    if "rigid" in learning.get("name", ""):
        pytest.importorskip("pinocchio")
    learner = new_network(with_learning(config, **learning))
    assert type(learner) is kind
    assert (getattr(learner, "base", None) is not None) == (learning.get("name") == "rigid_body+lms_tree")
    assert learner.trials_learned == 0


def test_a_learner_is_told_about_the_arm_and_the_goal_movement(config: Config) -> None:
    context = learner_context(config)
    assert context.joints == ("shoulder", "elbow")
    assert context.stiffness_nm_per_rad == (15.0, 15.0)
    assert context.damping_nms_per_rad == (1.5, 1.5)
    assert context.learning == config.learning
    assert context.seed == 7
    assert context.urdf == Path(config.arm.urdf).read_text(encoding="utf-8")
    slower = learner_context(
        dataclasses.replace(config, practice=dataclasses.replace(config.practice, goal_duration_s=9.0))
    )
    # Half of the speed, a quarter of the acceleration.
    np.testing.assert_allclose(slower.input_range.high[2:4], 0.5 * context.input_range.high[2:4], rtol=1e-3)
    np.testing.assert_allclose(slower.input_range.high[4:], 0.25 * context.input_range.high[4:], rtol=1e-3)


def test_a_learner_that_the_run_cannot_have_is_refused_under_its_key(
    config: Config, installed: Callable[..., None]
) -> None:
    with pytest.raises(ConfigError, match=r"^learning\.name is 'no_such'; expected one of lms_tree, "):
        new_network(with_learning(config, name="no_such"))


def test_what_a_learner_cannot_do_is_said_under_the_key_of_the_section(
    config: Config, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "pinocchio", None)
    with pytest.raises(ConfigError, match=r"^learning\.name is 'rigid_body'; expected .*pip install pin"):
        new_network(with_learning(config, name="rigid_body"))


def test_a_run_goes_on_from_the_network_of_an_earlier_one(config: Config, tmp_path: Path) -> None:
    earlier = new_network(config)
    earlier.trials_learned = 5
    save_network(earlier, tmp_path / "earlier.npz")
    assert new_network(starting_from(config, tmp_path / "earlier.npz")).trials_learned == 5


def starting_from(config: Config, file: Path) -> Config:
    return dataclasses.replace(config, learning=dataclasses.replace(config.learning, start_from=str(file)))


def test_a_network_of_an_arm_with_other_springs_is_refused(config: Config, tmp_path: Path) -> None:
    save_network(new_network(config), tmp_path / "earlier.npz")
    stiffer = dataclasses.replace(
        config, arm=dataclasses.replace(config.arm, stiffness_nm_per_rad=(20.0, 15.0))
    )
    with pytest.raises(
        ConfigError, match=r"learning.start_from.*earlier.npz.*\[20.0, 15.0\], not \[15.0, 15.0\]"
    ):
        new_network(starting_from(stiffer, tmp_path / "earlier.npz"))


def test_a_network_of_torque_never_becomes_one_of_equilibrium_points(config: Config, tmp_path: Path) -> None:
    """Its outputs are no offsets, even where its joints and springs look right: the arm would follow them."""
    torque = new_network(config)
    torque.context = dataclasses.replace(torque.context, predicts="torque")
    save_network(torque, tmp_path / "imported.npz")
    with pytest.raises(ConfigError, match=r"learning.start_from.*imported.npz.*this one predicts torque"):
        new_network(starting_from(config, tmp_path / "imported.npz"))


def test_a_missing_network_to_go_on_from_is_named(config: Config, tmp_path: Path) -> None:
    with pytest.raises(NetworkFileError, match="earlier.npz: there is no such file"):
        new_network(starting_from(config, tmp_path / "earlier.npz"))
