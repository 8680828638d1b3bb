"""The simulated arm obeys the equations of motion, and nothing else acts on it."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pybullet
import pytest
from analytic import PlanarArm

from sim_bridge.arm import SimulatedArm

MakeArm = Callable[..., SimulatedArm]

PHYSICS_RATE_HZ = 4000.0

# What the simulated arm is told, and the same for the formulas.
CASES = {
    "as described": ({}, PlanarArm()),
    "no friction": (
        {"viscous_friction_nms_per_rad": (0.0, 0.0)},
        PlanarArm(viscous_nms_per_rad=(0.0, 0.0)),
    ),
    "other viscous friction": (
        {"viscous_friction_nms_per_rad": (0.4, 0.15)},
        PlanarArm(viscous_nms_per_rad=(0.4, 0.15)),
    ),
    "dry friction": ({"coulomb_friction_nm": (0.7, 0.3)}, PlanarArm(coulomb_nm=(0.7, 0.3))),
    "payload": ({"payload_kg": 0.8}, PlanarArm(payload_kg=0.8)),
    "heavier": ({"inertia_scale": 1.7}, PlanarArm(inertia_scale=1.7)),
    "everything": (
        {
            "viscous_friction_nms_per_rad": (0.4, 0.15),
            "coulomb_friction_nm": (0.7, 0.3),
            "payload_kg": 0.8,
            "inertia_scale": 0.6,
        },
        PlanarArm(viscous_nms_per_rad=(0.4, 0.15), coulomb_nm=(0.7, 0.3), payload_kg=0.8, inertia_scale=0.6),
    ),
}

ONE_LINK = """
<robot name="pendulum">
  <link name="base"/>
  <link name="hand">
    <inertial>
      <origin xyz="0.2 0 0"/>
      <mass value="1.5"/>
      <inertia ixx="0.001" ixy="0" ixz="0" iyy="0.03" iyz="0" izz="0.03"/>
    </inertial>
  </link>
  <joint name="pivot" type="continuous">
    <parent link="base"/>
    <child link="hand"/>
    <axis xyz="{axis}"/>
    <dynamics damping="0.3" friction="0.2"/>
  </joint>
</robot>
"""


@pytest.fixture
def one_link_arm(make_arm: MakeArm, tmp_path: Path) -> Callable[..., SimulatedArm]:
    """Make an arm of one link that turns about ``axis``, with friction only where asked for."""

    def make(axis: str, **sim: object) -> SimulatedArm:
        path = tmp_path / "one_link.urdf"
        path.write_text(ONE_LINK.format(axis=axis))
        free = {"viscous_friction_nms_per_rad": (0.0,), "coulomb_friction_nm": (0.0,), "encoder_bits": 0}
        return make_arm(urdf=path, arm={"joints": ("pivot",)}, **(free | sim))

    return make


@pytest.mark.parametrize("case", CASES)
def test_accelerations_agree_with_the_equations_of_motion(make_arm: MakeArm, case: str) -> None:
    """A physics step changes the velocity by exactly q̈ dt (semi-implicit Euler): no error of its own.

    What remains is rounding: 1e-16 of a speed of 8 rad/s in a change of some 0.01 rad/s, times the condition
    of the mass matrix: 3e-12 at worst in 14,000 states. Every joint is fast enough to slide through the
    whole step.
    """
    sim, analytic = CASES[case]
    arm = make_arm(encoder_bits=0, rate_hz=PHYSICS_RATE_HZ, **sim)
    rng = np.random.default_rng(7)
    for _ in range(200):
        q = rng.uniform(-2.5, 2.5, 2)
        v = rng.uniform(1.0, 8.0, 2) * rng.choice([-1.0, 1.0], 2)
        torque_nm = rng.uniform(-20.0, 20.0, 2)
        arm.set_state(q, v)
        arm.step(torque_nm)
        new_v = np.array(arm.reading().velocity_rad_s)
        expected = analytic.acceleration(q, v, torque_nm)
        error = np.linalg.norm((new_v - v) * PHYSICS_RATE_HZ - expected) / np.linalg.norm(expected)
        assert error < 1e-9
        assert np.allclose(arm.reading().position_rad, q + new_v / PHYSICS_RATE_HZ, rtol=0.0, atol=1e-14)


def swing_drift(arm: SimulatedArm, start_rad_s: tuple[float, float]) -> float:
    """Return the largest relative change of energy in 5 s of free swing."""
    analytic = PlanarArm()
    arm.set_state([0.3, 1.2], start_rad_s)
    start_j = analytic.kinetic_energy(np.array([0.3, 1.2]), np.array(start_rad_s))
    drift = 0.0
    for _ in range(5 * 500):
        arm.step([0.0, 0.0])
        q, v = np.array(arm.true_position_rad), np.array(arm.true_velocity_rad_s)
        drift = max(drift, abs(analytic.kinetic_energy(q, v) / start_j - 1.0))
    return drift


@pytest.mark.parametrize("start_rad_s", [(3.0, 4.0), (4.0, -6.0), (0.0, 8.0)])
def test_a_free_swing_keeps_its_energy(
    make_arm: MakeArm, endless_urdf: Path, start_rad_s: tuple[float, float]
) -> None:
    """The joints reach 9 to 11 rad/s in these swings, twice the speed of the fastest practice trial."""
    arm = make_arm(urdf=endless_urdf, encoder_bits=0, viscous_friction_nms_per_rad=(0.0, 0.0))
    assert swing_drift(arm, start_rad_s) < 0.01


def test_half_the_physics_step_halves_the_drift_of_energy(make_arm: MakeArm, endless_urdf: Path) -> None:
    """What drifts is the integration, of first order, and not a force that should not be there."""
    free = {"urdf": endless_urdf, "encoder_bits": 0, "viscous_friction_nms_per_rad": (0.0, 0.0)}
    coarse = swing_drift(make_arm(physics_rate_hz=4000.0, **free), (3.0, 4.0))
    fine = swing_drift(make_arm(physics_rate_hz=8000.0, **free), (3.0, 4.0))
    assert fine == pytest.approx(0.5 * coarse, rel=0.05)


def test_a_joint_without_friction_keeps_its_speed(one_link_arm: Callable[..., SimulatedArm]) -> None:
    """Fails with PyBullet's default motors, linear or angular damping, or the URDF's own friction left on."""
    arm = one_link_arm("0 0 1")
    arm.set_state([0.0], [5.0])
    for _ in range(1000):
        arm.step([0.0])
    assert arm.true_velocity_rad_s[0] == pytest.approx(5.0, rel=1e-12)


def test_a_joint_may_turn_faster_than_pybullets_own_limit(one_link_arm: Callable[..., SimulatedArm]) -> None:
    arm = one_link_arm("0 0 1")
    arm.set_state([0.0], [150.0])
    arm.step([0.0])
    assert arm.true_velocity_rad_s[0] == pytest.approx(150.0, rel=1e-12)


def test_gravity_pulls_on_a_joint_with_a_horizontal_axis(one_link_arm: Callable[..., SimulatedArm]) -> None:
    arm = one_link_arm("0 -1 0", physics_rate_hz=500.0)
    arm.set_state([0.4], [0.0])
    arm.step([0.0])
    acceleration = arm.true_velocity_rad_s[0] * 500.0
    assert acceleration == pytest.approx(-1.5 * 9.80665 * 0.2 * np.cos(0.4) / (0.03 + 1.5 * 0.2**2), rel=1e-9)


def test_friction_of_the_urdf_acts_unless_it_is_replaced(one_link_arm: Callable[..., SimulatedArm]) -> None:
    arm = one_link_arm(
        "0 0 1", physics_rate_hz=500.0, viscous_friction_nms_per_rad=(), coulomb_friction_nm=()
    )
    arm.set_state([0.0], [2.0])
    arm.step([0.0])
    expected = -(0.3 * 2.0 + 0.2) / (0.03 + 1.5 * 0.2**2)
    assert (arm.true_velocity_rad_s[0] - 2.0) * 500.0 == pytest.approx(expected, rel=1e-9)


def test_a_torque_acts_through_the_whole_control_period(make_arm: MakeArm) -> None:
    """PyBullet forgets a torque after one physics step."""
    coarse, fine = make_arm(rate_hz=500.0), make_arm(rate_hz=4000.0)
    coarse.step([3.0, -1.0])
    for _ in range(8):
        fine.step([3.0, -1.0])
    assert coarse.true_position_rad == fine.true_position_rad
    assert coarse.true_velocity_rad_s == fine.true_velocity_rad_s


@pytest.mark.parametrize("link", ["hand", "base"])
def test_a_link_without_inertial_has_no_mass(
    make_arm: MakeArm, edited_urdf: Callable[..., Path], planar_arm_urdf: Path, link: str
) -> None:
    text = planar_arm_urdf.read_text(encoding="utf-8")
    start = text.index(f'<link name="{link}">')
    end = text.index("</link>", start) + len("</link>")
    bare = make_arm(urdf=edited_urdf({text[start:end]: f'<link name="{link}"/>'}), rate_hz=PHYSICS_RATE_HZ)
    bare.set_state([0.5, 1.0], [3.0, -4.0])
    bare.step([2.0, 1.0])
    expected = PlanarArm().acceleration(np.array([0.5, 1.0]), np.array([3.0, -4.0]), np.array([2.0, 1.0]))
    change = np.array(bare.true_velocity_rad_s) - [3.0, -4.0]
    assert np.allclose(change * PHYSICS_RATE_HZ, expected, rtol=1e-9, atol=0.0)


def test_the_base_does_not_move_even_if_it_has_a_mass(
    make_arm: MakeArm, edited_urdf: Callable[..., Path]
) -> None:
    inertia = '<inertia ixx="0.01" ixy="0" ixz="0" iyy="0.01" iyz="0" izz="0.01"/>'
    inertial = f'<inertial><mass value="5"/>{inertia}</inertial>'
    heavy = make_arm(urdf=edited_urdf({'<link name="base">': f'<link name="base">{inertial}'}))
    usual = make_arm()
    for arm in (heavy, usual):
        for _ in range(50):
            arm.step([5.0, -3.0])
    assert heavy.reading() == usual.reading()


def test_dry_friction_holds_and_slides_as_it_must_when_joints_pull_at_each_other(make_arm: MakeArm) -> None:
    """From rest, friction is at most c, and exactly c against the motion of a joint that starts to move.

    Fails with PyBullet's default solver settings, which stop too early. Fewer than 20 of each kind would mean
    that the drawn torques test nothing.
    """
    coulomb_nm = np.array([1.0, 0.3])
    arm = make_arm(encoder_bits=0, rate_hz=PHYSICS_RATE_HZ, coulomb_friction_nm=tuple(coulomb_nm))
    analytic = PlanarArm()
    rng = np.random.default_rng(3)
    n_held = n_started = 0
    for _ in range(200):
        q, torque_nm = rng.uniform(-2.5, 2.5, 2), rng.uniform(-1.5, 1.5, 2)
        arm.set_state(q, [0.0, 0.0])
        arm.step(torque_nm)
        acceleration = np.array(arm.true_velocity_rad_s) * PHYSICS_RATE_HZ
        friction_nm = analytic.mass_matrix(q) @ acceleration - torque_nm
        moves = np.abs(acceleration) > 1e-6
        assert np.all(np.abs(friction_nm) <= coulomb_nm + 1e-8)
        assert np.allclose(
            friction_nm[moves], -(coulomb_nm * np.sign(acceleration))[moves], rtol=0.0, atol=1e-8
        )
        n_held, n_started = n_held + np.sum(~moves), n_started + np.sum(moves)
    assert min(n_held, n_started) >= 20


def test_a_joint_held_by_dry_friction_does_not_creep(make_arm: MakeArm) -> None:
    arm = make_arm(encoder_bits=0, coulomb_friction_nm=(0.5, 0.5))
    arm.set_state([0.2, 1.0], [1.0, -1.0])
    for _ in range(1000):
        arm.step([0.3, -0.2])
    stopped_rad = arm.true_position_rad
    for _ in range(1000):
        arm.step([0.3, -0.2])
        assert arm.at_rest(1e-9)
    assert arm.true_position_rad == pytest.approx(stopped_rad, rel=0.0, abs=1e-9)


def test_a_joint_stops_at_the_end_of_its_range(make_arm: MakeArm) -> None:
    """A hard stop gives way by what a joint covers in a physics step or two, and no more."""
    arm = make_arm(encoder_bits=0)
    arm.set_state([2.7, 0.0], [3.0, 0.0])
    furthest_rad = 0.0
    for _ in range(500):
        arm.step([5.0, 0.0])
        furthest_rad = max(furthest_rad, arm.true_position_rad[0])
    assert 2.9 - 1e-3 < arm.true_position_rad[0] <= furthest_rad < 2.9 + 0.01


def test_the_payload_hangs_at_the_hand_even_if_the_hand_has_a_mass_of_its_own(
    make_arm: MakeArm, edited_urdf: Callable[..., Path]
) -> None:
    """Two point masses in one place are one."""
    heavy_hand = make_arm(urdf=edited_urdf({'<mass value="0"/>': '<mass value="0.3"/>'}), payload_kg=0.5)
    light_hand = make_arm(payload_kg=0.8)
    for arm in (heavy_hand, light_hand):
        arm.set_state([0.1, 0.9], [2.0, 3.0])
        arm.step([1.0, -1.0])
    assert heavy_hand.true_velocity_rad_s == pytest.approx(light_hand.true_velocity_rad_s, rel=1e-12)


def test_the_order_of_joints_is_that_of_the_configuration(make_arm: MakeArm) -> None:
    usual = make_arm(initial_position_rad=(0.2, 1.1))
    swapped = make_arm(initial_position_rad=(1.1, 0.2), arm={"joints": ("elbow", "shoulder")})
    usual.step([3.0, 0.5])
    swapped.step([0.5, 3.0])
    assert usual.true_velocity_rad_s == swapped.true_velocity_rad_s[::-1]


def test_other_simulations_in_the_process_neither_notice_nor_matter(make_arm: MakeArm) -> None:
    """Without a client id, PyBullet's functions act on the first simulation of the process."""
    alone = make_arm()
    for _ in range(20):
        alone.step([1.0, 2.0])
    alone.close()

    first = pybullet.connect(pybullet.DIRECT)
    assert first == 0, "this test needs the id that PyBullet's functions take by default"
    try:
        ball = pybullet.createMultiBody(baseMass=1.0, basePosition=[0.0, 0.0, 5.0], physicsClientId=first)
        before = pybullet.getPhysicsEngineParameters(physicsClientId=first)
        one, other = make_arm(), make_arm()
        for _ in range(20):
            one.step([1.0, 2.0])
            other.step([-2.0, 1.0])
        assert pybullet.getPhysicsEngineParameters(physicsClientId=first) == before
        assert pybullet.getNumBodies(physicsClientId=first) == 1
        assert pybullet.getBasePositionAndOrientation(ball, physicsClientId=first)[0] == (0.0, 0.0, 5.0)
    finally:
        pybullet.disconnect(first)
    assert one.reading() == alone.reading()
    assert other.reading() != alone.reading()


PRINTS_FROM_C = """
import ctypes
from sim_bridge.physics import rerouted

print("before")
with rerouted(1, to=2):
    ctypes.CDLL(None).printf(b"from C")
print("after")
"""


def test_only_what_is_printed_from_c_meanwhile_goes_to_standard_error() -> None:
    """C keeps what it prints in a buffer of its own; it must not come out after the switch back."""
    done = subprocess.run(
        [sys.executable, "-c", PRINTS_FROM_C],
        # With PYTHONUNBUFFERED Python switches C's buffer off, and there would be nothing to test.
        env=os.environ | {"PYTHONPATH": os.pathsep.join(sys.path), "PYTHONUNBUFFERED": ""},
        capture_output=True,
        text=True,
        timeout=50,
        check=True,
    )
    assert done.stdout.split() == ["before", "after"]
    assert done.stderr.endswith("from C")
