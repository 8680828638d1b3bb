"""What the errors say and keep."""

from __future__ import annotations

import pytest

from tel_ros.core.errors import ConfigError, InputFileError, NetworkFileError, TelError, look_alikes


def test_a_configuration_error_names_source_key_value_and_expectation() -> None:
    error = ConfigError("sim.clock", "fast", "lockstep or realtime", "run.yaml")
    assert str(error) == "run.yaml: sim.clock is 'fast'; expected lockstep or realtime"
    assert (error.key, error.value, error.source) == ("sim.clock", "fast", "run.yaml")


def test_seen_from_outside_the_key_is_longer_and_the_nearest_source_stays() -> None:
    inner = ConfigError("clock", 1, "a name")
    assert str(inner.inside("sim", "run.yaml")) == "run.yaml: sim.clock is 1; expected a name"
    assert inner.inside("sim", "a.yaml").inside("", "b.yaml").source == "a.yaml"


def test_a_file_error_names_the_file_what_is_wrong_and_what_was_expected() -> None:
    error = NetworkFileError("net.npz", "is empty", "a network")
    assert str(error) == "net.npz: is empty; expected a network"
    assert isinstance(error, InputFileError)
    assert isinstance(error, TelError)


@pytest.mark.parametrize(
    ("existing", "alike"),
    [
        (["/clock", "/rosout"], []),
        (["/joint_states"], []),
        (["/dynamic_joint_states"], []),
        (["/robot1/joint_states", "/tf"], ["/robot1/joint_states"]),
        (["/a/joint_state", "/b/joint_states"], ["/b/joint_states", "/a/joint_state"]),
    ],
)
def test_names_in_another_namespace_or_spelt_alike_may_be_meant(
    existing: list[str], alike: list[str]
) -> None:
    assert look_alikes("/joint_states", existing) == alike
