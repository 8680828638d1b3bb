"""The promises of the simulated arm: time, commands, determinism, and refusals."""

from __future__ import annotations

import hashlib
import math
import os
import subprocess
import sys
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pytest

from sim_bridge.arm import CommandError, SimulatedArm
from sim_bridge.physics import SimulationError
from tel_ros.core.errors import ConfigError

MakeArm = Callable[..., SimulatedArm]


def run(arm: SimulatedArm, commands_nm: Sequence[Sequence[float]]) -> list[object]:
    """Return the reading before each command and the one after the last."""
    readings = [arm.reading()]
    for command_nm in commands_nm:
        arm.step(command_nm)
        readings.append(arm.reading())
    return readings


def random_commands(n: int) -> list[list[float]]:
    return np.random.default_rng(0).uniform(-6.0, 6.0, (n, 2)).tolist()


def test_an_arm_starts_at_rest_in_the_middle_of_its_range(make_arm: MakeArm) -> None:
    arm = make_arm(encoder_bits=0, arm={"position_min_rad": (-0.1, 0.5), "position_max_rad": (1.3, 2.1)})
    reading = arm.reading()
    assert reading.position_rad == pytest.approx((0.6, 1.3))
    assert reading.velocity_rad_s == (0.0, 0.0)
    assert reading.effort_nm == (0.0, 0.0)
    assert reading.time_ns == 0
    assert arm.at_rest()


def test_the_state_does_not_yet_feel_the_command_of_its_time(make_arm: MakeArm) -> None:
    arm = make_arm(encoder_bits=0, initial_position_rad=(0.3, 1.0))
    before = arm.reading()
    assert before.position_rad == (0.3, 1.0)
    arm.step([5.0, 0.0])
    assert before.position_rad == (0.3, 1.0)
    assert arm.reading().effort_nm == (5.0, 0.0)
    assert arm.reading().velocity_rad_s[0] > 0.01


def test_a_reading_stays_the_same_until_the_next_step(make_arm: MakeArm) -> None:
    arm = make_arm(position_noise_rad=0.01)
    assert arm.reading() is arm.reading()
    before = arm.reading()
    arm.step([0.0, 0.0])
    assert arm.reading().position_rad != before.position_rad


@pytest.mark.parametrize(("rate_hz", "physics_rate_hz"), [(500.0, 4000.0), (600.0, 4800.0), (1000.0, 4000.0)])
def test_time_counts_periods_without_adding_up_rounding(
    make_arm: MakeArm, rate_hz: float, physics_rate_hz: float
) -> None:
    arm = make_arm(rate_hz=rate_hz, physics_rate_hz=physics_rate_hz)
    for n in range(1, 100):
        arm.step([0.0, 0.0])
        assert arm.reading().time_ns == math.floor(n * 1_000_000_000 / rate_hz)
    assert arm.reading().time_ns * 1e-9 == pytest.approx(99 / rate_hz, abs=1e-9)


def test_an_effort_is_clipped_to_the_limit_and_reported_as_applied(make_arm: MakeArm) -> None:
    limited = make_arm(encoder_bits=0, arm={"effort_limit_nm": (3.0, 2.0)})
    exact = make_arm(encoder_bits=0)
    limited.step([100.0, -50.0])
    exact.step([3.0, -2.0])
    assert limited.reading() == exact.reading()
    assert limited.reading().effort_nm == (3.0, -2.0)


def test_the_urdf_limits_the_effort_whatever_the_configuration_says(make_arm: MakeArm) -> None:
    arm = make_arm(arm={"effort_limit_nm": (100.0, 4.0)})
    assert arm.effort_limit_nm == (20.0, 4.0)
    arm.step([50.0, 50.0])
    assert arm.reading().effort_nm == (20.0, 4.0)


@pytest.mark.parametrize("n_periods", [1, 3])
def test_a_delayed_command_acts_exactly_so_many_periods_later(make_arm: MakeArm, n_periods: int) -> None:
    prompt, late = make_arm(encoder_bits=0), make_arm(encoder_bits=0, command_delay_s=n_periods * 0.002)
    commands_nm = random_commands(20)
    prompt_readings = run(prompt, commands_nm)
    late_readings = run(late, commands_nm + [[0.0, 0.0]] * n_periods)
    assert all(reading.effort_nm == (0.0, 0.0) for reading in late_readings[: n_periods + 1])
    for early, later in zip(prompt_readings[1:], late_readings[n_periods + 1 :], strict=True):
        assert later.time_ns == early.time_ns + n_periods * 2_000_000
        assert later.effort_nm == early.effort_nm
        assert later.position_rad == early.position_rad


def test_coasting_is_zero_effort_at_once_even_with_commands_on_their_way(make_arm: MakeArm) -> None:
    arm = make_arm(command_delay_s=0.004)
    for _ in range(3):
        arm.step([5.0, 5.0])
    assert arm.reading().effort_nm == (5.0, 5.0)
    efforts = []
    for _ in range(4):
        arm.coast()
        efforts.append(arm.reading().effort_nm)
    arm.step([1.0, 1.0])
    efforts.append(arm.reading().effort_nm)
    assert efforts == [(0.0, 0.0)] * 5
    assert arm.reading().time_ns == 8 * 2_000_000


@pytest.mark.parametrize(
    "command_nm", [[math.nan, 0.0], [0.0, math.inf], [1.0], [1.0, 2.0, 3.0], []], ids=str
)
def test_a_bad_command_is_refused_and_changes_nothing(make_arm: MakeArm, command_nm: list[float]) -> None:
    arm, untouched = make_arm(command_delay_s=0.002), make_arm(command_delay_s=0.002)
    before = arm.reading()
    with pytest.raises(CommandError) as refusal:
        arm.step(command_nm)
    assert str(command_nm) in str(refusal.value)
    assert "2 finite numbers of N·m, one for each of the joints shoulder, elbow" in str(refusal.value)
    assert arm.reading() is before
    assert run(arm, random_commands(5)) == run(untouched, random_commands(5))


def test_an_array_is_a_command_too(make_arm: MakeArm) -> None:
    arm, other = make_arm(), make_arm()
    arm.step(np.array([1.5, -0.5]))
    other.step([1.5, -0.5])
    assert arm.reading() == other.reading()


def test_a_moving_arm_is_not_at_rest(make_arm: MakeArm) -> None:
    arm = make_arm()
    arm.set_state([0.0, 1.0], [0.0, -0.04])
    assert not arm.at_rest()
    assert arm.at_rest(0.05)


def test_an_arm_put_into_a_state_goes_on_as_one_that_started_there(make_arm: MakeArm) -> None:
    used, fresh = (
        make_arm(coulomb_friction_nm=(0.2, 0.1), initial_position_rad=(0.4, 1.2)) for _ in range(2)
    )
    run(used, random_commands(100))
    used.set_state([0.4, 1.2], [0.0, 0.0])
    for command_nm in random_commands(50):
        used.step(command_nm)
        fresh.step(command_nm)
        assert used.reading().position_rad == fresh.reading().position_rad
        assert used.reading().velocity_rad_s == fresh.reading().velocity_rad_s


@pytest.mark.parametrize(
    ("position_rad", "velocity_rad_s", "message"),
    [
        ([0.0, 3.5], [0.0, 0.0], "elbow -2.9 to 2.9"),
        ([math.nan, 0.0], [0.0, 0.0], "one value in rad a joint"),
        ([0.0], [0.0, 0.0], "one value in rad a joint"),
        ([0.0, 0.0], [0.0, math.inf], "a finite velocity for each of the joints shoulder, elbow"),
        ([0.0, 0.0], [0.0], "a finite velocity for each of the joints shoulder, elbow"),
    ],
)
def test_an_impossible_state_is_refused(
    make_arm: MakeArm, position_rad: list[float], velocity_rad_s: list[float], message: str
) -> None:
    with pytest.raises(ConfigError, match=message):
        make_arm().set_state(position_rad, velocity_rad_s)


@pytest.mark.parametrize(
    ("sim", "message"),
    [
        (
            {"initial_position_rad": (0.0, 3.5)},
            r"sim.initial_position_rad is \[0.0, 3.5\]; expected one value in rad a joint, "
            r"within shoulder -2.9 to 2.9, elbow -2.9 to 2.9",
        ),
        (
            {"initial_position_rad": (0.0,)},
            r"sim.initial_position_rad is \[0.0\]; expected nothing, or one value",
        ),
        ({"viscous_friction_nms_per_rad": (0.1,)}, r"sim.viscous_friction_nms_per_rad is \[0.1\]; expected"),
        ({"coulomb_friction_nm": (0.1, 0.1, 0.1)}, r"sim.coulomb_friction_nm is \[0.1, 0.1, 0.1\]; expected"),
        (
            {"physics_rate_hz": 4100.0},
            "sim.physics_rate_hz is 4100.0; expected a whole multiple of the control rate 500",
        ),
        ({"command_delay_s": 0.003}, "sim.command_delay_s is 0.003; expected a whole multiple .* 0.002 s"),
    ],
)
def test_values_that_do_not_fit_the_arm_are_refused(
    make_arm: MakeArm, sim: dict[str, object], message: str
) -> None:
    with pytest.raises(ConfigError, match=message) as refusal:
        make_arm(**sim)
    assert "\n" not in str(refusal.value)


def test_a_window_without_a_display_is_refused(make_arm: MakeArm, monkeypatch: pytest.MonkeyPatch) -> None:
    """PyBullet itself would end the process."""
    monkeypatch.delenv("DISPLAY", raising=False)
    with pytest.raises(ConfigError, match="sim.gui is True; expected false, since there is no display"):
        make_arm(gui=True)


def test_a_closed_arm_says_so_and_leaves_the_next_one_alone(make_arm: MakeArm) -> None:
    """PyBullet gives the number of a closed simulation to the next one."""
    closed = make_arm()
    closed.close()
    closed.close()
    following = make_arm()
    with pytest.raises(SimulationError, match="closed"):
        closed.step([5.0, 5.0])
    with pytest.raises(SimulationError, match="closed"):
        closed.set_state([1.0, 1.0], [0.0, 0.0])
    following.coast()
    assert following.true_velocity_rad_s == make_arm().true_velocity_rad_s


def test_a_simulation_that_diverges_says_so(make_arm: MakeArm) -> None:
    """So much friction reverses the motion in each physics step, and more of it each time."""
    arm = make_arm(viscous_friction_nms_per_rad=(5000.0, 5000.0))
    arm.set_state([0.0, 1.0], [1.0, 1.0])
    with pytest.raises(SimulationError, match="diverged at .* higher sim.physics_rate_hz"):
        for _ in range(500):
            arm.step([0.0, 0.0])


SCRIPT = """
import hashlib, sys
import numpy as np
from sim_bridge.arm import SimulatedArm
from tel_ros.core.config import ArmConfig, SimConfig

arm = ArmConfig(
    name="planar", urdf=sys.argv[1], joints=("shoulder", "elbow"), hand_link="hand",
    stiffness_nm_per_rad=(15.0, 15.0), damping_nms_per_rad=(1.5, 1.5), effort_limit_nm=(20.0, 20.0),
)
sim = SimConfig(position_noise_rad=1e-4, command_delay_s=0.004, coulomb_friction_nm=(0.2, 0.1))
digest = hashlib.sha256()
with SimulatedArm(arm, sim, rate_hz=500.0, seed=11) as plant:
    for command in np.random.default_rng(0).uniform(-6.0, 6.0, (500, 2)).tolist():
        plant.step(command)
        digest.update(repr(plant.reading()).encode())
sys.stderr.write("digest " + digest.hexdigest())
"""


def run_script(script: str, *arguments: object, **environment: str) -> subprocess.CompletedProcess[str]:
    """Run Python code in a process of its own."""
    return subprocess.run(
        [sys.executable, "-c", script, *map(str, arguments)],
        # PYTHONUNBUFFERED would hide what C prints late.
        env=os.environ | {"PYTHONPATH": os.pathsep.join(sys.path), "PYTHONUNBUFFERED": ""} | environment,
        capture_output=True,
        text=True,
        timeout=50,
        check=False,
    )


def test_processes_agree_to_the_last_bit_and_print_nothing(make_arm: MakeArm, planar_arm_urdf: Path) -> None:
    arm = make_arm(position_noise_rad=1e-4, command_delay_s=0.004, coulomb_friction_nm=(0.2, 0.1), seed=11)
    here = hashlib.sha256()
    for command_nm in random_commands(500):
        arm.step(command_nm)
        here.update(repr(arm.reading()).encode())
    for hash_seed in ("1", "2"):
        done = run_script(SCRIPT, planar_arm_urdf, PYTHONHASHSEED=hash_seed)
        assert done.returncode == 0, done.stderr
        assert done.stderr.endswith(f"digest {here.hexdigest()}")
        assert done.stdout == ""
