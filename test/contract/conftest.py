"""The implementations that the contract is tested on."""

from __future__ import annotations

import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent))

from arm_under_test import ArmUnderTest  # noqa: E402
from follower_under_test import FollowerUnderTest  # noqa: E402
from ros_domain import held_domains  # noqa: E402

from tel_ros.app.bring_up import NodeProcesses  # noqa: E402
from tel_ros.core.config import Config  # noqa: E402
from tel_ros.recording.config_file import dump_config, load_config  # noqa: E402

HERE = Path(__file__).parent
CONFIG = HERE.parents[1] / "config" / "planar_arm.yaml"
RATE_HZ = 200
OURS = (
    "sim_bridge in real time",
    "sim_bridge in lockstep",
    "position drives in real time",
    "position drives in lockstep",
    "fake arm",
)
FOLLOWERS = ("stand-in in real time", "stand-in in lockstep")


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add the options; they are known when this folder is named on the command line."""
    parser.addoption("--arm-config", help="run configuration of a running arm (run.arm: external)")
    parser.addoption("--hostile-commands", action="store_true", help="also commands that no arm must obey")


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    """Run every test on our own implementations, or on the one that was named."""
    for fixture, names in (("arm", OURS), ("follower", FOLLOWERS)):
        if fixture in metafunc.fixturenames:
            named = metafunc.config.getoption("--arm-config", default=None)
            # Where time waits for commands, a busy machine changes nothing.
            marks = {name: () if "lockstep" in name else (pytest.mark.realtime,) for name in names}
            ours = [pytest.param(name, marks=marks[name]) for name in names]
            metafunc.parametrize(fixture, [named] if named else ours, indirect=True, scope="module")


@pytest.fixture(scope="module")
def arm(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Iterator[ArmUnderTest]:
    """Return a running arm; one that is ours has a ROS domain of its own."""
    if request.param not in OURS:
        config = load_config(request.param)
        if config.arm.command_interface == "trajectory":
            pytest.skip("it takes trajectories: test_trajectory_contract.py")
        hostile = request.config.getoption("--hostile-commands")
        with ArmUnderTest(config, lockstep=False, obeys_nobody=not hostile) as running:
            yield running
        return
    interface = "position" if "position" in request.param else "effort"
    with _own_domain(interface) as config:
        if request.param == "fake arm":
            yield from _fake(config)
        else:
            lockstep = "lockstep" in request.param
            with (
                _simulated(config, lockstep, tmp_path_factory.mktemp("arm")) as config,
                ArmUnderTest(config, lockstep=lockstep) as running,
            ):
                yield running


@pytest.fixture(scope="module")
def follower(
    request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory
) -> Iterator[FollowerUnderTest]:
    """Return a running joint_trajectory_controller, or what stands in for it in a ROS domain of its own."""
    if request.param not in FOLLOWERS:
        config = load_config(request.param)
        if config.arm.command_interface != "trajectory":
            pytest.skip("it takes a command for each state: test_arm_contract.py")
        with FollowerUnderTest(config) as running:
            yield running
        return
    with (
        _own_domain("trajectory") as config,
        _simulated(config, "lockstep" in request.param, tmp_path_factory.mktemp("arm")) as config,
        FollowerUnderTest(config) as running,
    ):
        yield running


@contextmanager
def _own_domain(interface: str) -> Iterator[Config]:
    with held_domains() as domains, pytest.MonkeyPatch.context() as patch:
        patch.setenv("ROS_DOMAIN_ID", str(next(domains)))
        patch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
        yield load_config(CONFIG, [f"control.rate_hz={RATE_HZ}", f"arm.command_interface={interface}"])


@contextmanager
def _simulated(config: Config, lockstep: bool, folder: Path) -> Iterator[Config]:
    clock = "lockstep" if lockstep else "realtime"
    config = replace(config, sim=replace(config.sim, clock=clock))
    file = folder / "run.yaml"
    file.write_text(dump_config(config), encoding="utf-8")
    with NodeProcesses(file, ["sim_bridge"], folder / "log"):
        yield config


def _fake(config: Config) -> Iterator[ArmUnderTest]:
    process = subprocess.Popen([sys.executable, str(HERE / "fake_arm.py"), str(RATE_HZ), ""])
    try:
        with ArmUnderTest(config, lockstep=False) as running:
            yield running
    finally:
        process.send_signal(signal.SIGINT)
        process.wait(10.0)
