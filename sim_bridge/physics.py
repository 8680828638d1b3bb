"""PyBullet without its surprises: one arm, the torques that it is given, and nothing else that acts."""

from __future__ import annotations

import ctypes
import logging
import math
import os
import sys
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path

import numpy as np

from tel_ros.core.arm_description import ArmDescription
from tel_ros.core.config import ArmConfig, JointValues, SimConfig
from tel_ros.core.errors import ConfigError, TelError
from tel_ros.core.plain_urdf import MOST_LINKS, PAYLOAD_LINK, check_dynamics, inertial, plain_urdf, remarks
from tel_ros.recording.urdf import mesh_file


@contextmanager
def rerouted(descriptor: int, to: int) -> Iterator[None]:
    """Send what is written to a descriptor of the process (1: standard output, 2: standard error) elsewhere.

    PyBullet prints remarks past ``sys.stdout`` and ``sys.stderr``; there they would end up in the middle of
    JSON that another program reads. Works on the whole process, so keep it short: loading, not stepping.
    """
    libc = ctypes.CDLL(None)
    libc.fflush(None)
    kept = os.dup(descriptor)
    os.dup2(to, descriptor)
    try:
        yield
    finally:
        # C's own buffer would otherwise be written after the switch back.
        libc.fflush(None)
        os.dup2(kept, descriptor)
        os.close(kept)


with open(os.devnull, "wb") as _nowhere, rerouted(2, _nowhere.fileno()):  # it tells when it was built
    import pybullet as pybullet  # the laboratory takes it from here

_LOG = logging.getLogger(__name__)

STANDARD_GRAVITY_M_S2 = 9.80665

# PyBullet stops a joint at 100 rad/s without a word. Without a limit a simulation that diverges can be told.
SPEED_CLAMP_RAD_S = math.inf

# With PyBullet's defaults (50, 1e-7) the solver stops while the torque on a joint that dry friction holds is
# still up to 7 N·m wrong, if another joint slides. With these it is right to 1e-8 N·m, and no slower.
SOLVER_ITERATIONS = 200
SOLVER_RESIDUAL = 1e-24

CLOSED = "the simulated arm was closed; make a new one"


class SimulationError(TelError):
    """The simulation cannot go on: it was closed, or its state is no longer finite."""


class ArmPhysics:
    """An arm on a fixed base, advanced in physics steps (semi-implicit Euler).

    Viscous friction is -b q̇ at the start of each step. Dry friction is a motor without speed and with
    limited torque: the solver finds the torque within ±c that stops the joint, so that a joint sticks for
    real and slides with exactly c against it, without chatter. The ends of a joint's range are hard stops.
    Gravity acts along -z of the base. Links do not collide. Raises InputFileError: the URDF describes
    something that cannot be simulated; ConfigError: a window is wanted where there is no display.
    """

    def __init__(
        self,
        description: ArmDescription,
        arm: ArmConfig,
        sim: SimConfig,
        viscous_nms_per_rad: JointValues,
        coulomb_nm: JointValues,
    ) -> None:
        # Without a display PyBullet ends the whole process.
        if sim.gui and sys.platform.startswith("linux") and not os.environ.get("DISPLAY"):
            raise ConfigError("sim.gui", sim.gui, "false, since there is no display (DISPLAY is not set)")
        check_dynamics(description, arm.hand_link, sim.payload_kg)
        for remark in filter(None, (description.assumed, *remarks(description))):
            _LOG.warning("%s: %s", arm.urdf, remark)
        with rerouted(1, to=2):
            self._client = pybullet.connect(pybullet.GUI if sim.gui else pybullet.DIRECT)
            try:
                self._body = _load(description, arm, sim, self._client)
                n_links = pybullet.getNumJoints(self._body, physicsClientId=self._client)
                links = [
                    pybullet.getJointInfo(self._body, i, physicsClientId=self._client) for i in range(n_links)
                ]
                index = {link[1].decode(): link[0] for link in links}
                self._joints = [index[name] for name in description.joints]
                if max(self._joints) > MOST_LINKS:
                    found = f"its arm has {n_links} links with mass, or on the way to one"
                    raise description.urdf.refused(
                        found, f"at most {MOST_LINKS}: PyBullet tells no more states"
                    )
                self._switch_off_defaults(1.0 / sim.physics_rate_hz)
                self._set_friction(viscous_nms_per_rad, coulomb_nm)
                names = [link[12].decode() for link in links]
                self._check_inertia(description, names, sim.inertia_scale)
            except BaseException:
                self.close()
                raise

    def close(self) -> None:
        """End the simulation. A second time does nothing."""
        if self._client >= 0 and pybullet.isConnected(self._client):
            with rerouted(1, to=2):
                pybullet.disconnect(self._client)
        # PyBullet gives the number of a closed simulation to the next one.
        self._client = -1

    def advance(self, effort_nm: JointValues, n_steps: int) -> None:
        """Let physics steps pass under constant torques; SimulationError: the simulation was closed."""
        body, joints, client = self._body, self._joints, self._client
        set_torques, mode = pybullet.setJointMotorControlArray, pybullet.TORQUE_CONTROL
        step = pybullet.stepSimulation
        try:
            for _ in range(n_steps):
                # PyBullet forgets a torque after each physics step.
                set_torques(body, joints, mode, forces=effort_nm, physicsClientId=client)
                step(physicsClientId=client)
        except pybullet.error as error:
            raise SimulationError(CLOSED) from error

    def advance_driven(
        self, drive: Callable[[JointValues, JointValues], JointValues], n_steps: int
    ) -> JointValues:
        """Let physics steps pass under the torques with which a drive answers each state; return the last.

        ``drive`` goes from positions in rad and velocities in rad/s to torques in N·m.
        """
        for _ in range(n_steps):
            effort_nm = drive(*self.state())
            self.advance(effort_nm, 1)
        return effort_nm

    def state(self) -> tuple[JointValues, JointValues]:
        """Return the positions in rad and the velocities in rad/s of all joints."""
        states = pybullet.getJointStates(self._body, self._joints, physicsClientId=self._client)
        return tuple([state[0] for state in states]), tuple([state[1] for state in states])

    def set_state(self, position_rad: Sequence[float], velocity_rad_s: Sequence[float]) -> None:
        """Put the joints there, moving so; SimulationError: the simulation was closed."""
        try:
            for joint, position, velocity in zip(self._joints, position_rad, velocity_rad_s, strict=True):
                pybullet.resetJointState(self._body, joint, position, velocity, physicsClientId=self._client)
        except pybullet.error as error:
            raise SimulationError(CLOSED) from error

    def _switch_off_defaults(self, timestep_s: float) -> None:
        """Leave nothing that neither the URDF nor the configuration asks for."""
        client = self._client
        pybullet.setTimeStep(timestep_s, physicsClientId=client)
        pybullet.setGravity(0.0, 0.0, -STANDARD_GRAVITY_M_S2, physicsClientId=client)
        pybullet.setPhysicsEngineParameter(
            numSolverIterations=SOLVER_ITERATIONS,
            solverResidualThreshold=SOLVER_RESIDUAL,
            physicsClientId=client,
        )
        # -1 is the base, where PyBullet keeps these numbers for the whole arm.
        pybullet.changeDynamics(
            self._body,
            -1,
            linearDamping=0.0,
            angularDamping=0.0,
            maxJointVelocity=SPEED_CLAMP_RAD_S,
            physicsClientId=client,
        )

    def _set_friction(self, viscous_nms_per_rad: JointValues, coulomb_nm: JointValues) -> None:
        for joint, viscous in zip(self._joints, viscous_nms_per_rad, strict=True):
            pybullet.changeDynamics(self._body, joint, jointDamping=viscous, physicsClientId=self._client)
        # Unless told otherwise PyBullet brakes every joint with a motor. Limited to c it is dry friction.
        pybullet.setJointMotorControlArray(
            self._body,
            self._joints,
            pybullet.VELOCITY_CONTROL,
            targetVelocities=[0.0] * len(self._joints),
            forces=coulomb_nm,
            physicsClientId=self._client,
        )

    def _check_inertia(self, description: ArmDescription, links: Sequence[str], inertia_scale: float) -> None:
        """Refuse an inertia that PyBullet silently replaced."""
        for i, link in enumerate(links):
            if link == PAYLOAD_LINK:
                continue
            moments = pybullet.getDynamicsInfo(self._body, i, physicsClientId=self._client)[2]
            # The sum of the principal moments does not depend on the axes that PyBullet chose.
            expected_kgm2 = inertia_scale * np.trace(inertial(description.urdf, link).tensor_kgm2)
            if not math.isclose(sum(moments), expected_kgm2, rel_tol=1e-6):
                found = f"PyBullet takes the <inertia> of link {link!r} for {moments} kg·m²"
                raise description.urdf.refused(found, "one that a body can have")


def _load(description: ArmDescription, arm: ArmConfig, sim: SimConfig, client: int) -> int:
    text = plain_urdf(
        description,
        inertia_scale=sim.inertia_scale,
        payload_kg=sim.payload_kg,
        hand_link=arm.hand_link,
        stops_rad=description.stops_rad(arm),
        mesh=partial(mesh_file, Path(arm.urdf)) if sim.gui else None,
    )
    with tempfile.TemporaryDirectory(prefix="tel_ros_") as folder:
        path = Path(folder) / "arm.urdf"
        path.write_text(text, encoding="utf-8")
        try:
            # Without the flag PyBullet makes up the inertia from the shape.
            flags = pybullet.URDF_USE_INERTIA_FROM_FILE
            return int(pybullet.loadURDF(str(path), useFixedBase=True, flags=flags, physicsClientId=client))
        except pybullet.error as error:
            raise description.urdf.refused(f"PyBullet refuses it ({error})", "a URDF file") from error
