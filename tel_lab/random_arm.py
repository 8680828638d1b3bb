"""Random arms: simulations that differ from each other as real arms of one kind do, or by much more."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from tel_ros.core.config import SimConfig
from tel_ros.core.errors import ConfigError

Range = tuple[float, float]

NOMINAL_VISCOUS_FRICTION_NMS_PER_RAD = 0.05
"""That of each joint of ``planar_arm.urdf``; taken where a configuration leaves it to the URDF."""


@dataclass(frozen=True)
class ArmVariation:
    """How far random arms are from the configured one. All are (lowest, highest).

    Inertia and viscous friction are factors, drawn evenly in their logarithm, everything else evenly;
    frictions for each joint on its own. The Coulomb friction that is added to is 0 where the configuration
    leaves it to the URDF; the noise replaces the configured one.
    """

    inertia: Range
    viscous_friction: Range
    added_payload_kg: Range
    added_coulomb_friction_nm: Range
    position_noise_rad: Range


NEAR = ArmVariation(
    inertia=(0.8, 1.25),
    viscous_friction=(0.5, 2.0),
    added_payload_kg=(0.0, 0.0),
    added_coulomb_friction_nm=(0.0, 0.1),
    position_noise_rad=(0.0, 1e-4),
)
"""Arms that were meant to be equal, and how well such things are known."""

FAR = ArmVariation(
    inertia=(0.5, 2.0),
    viscous_friction=(0.25, 4.0),
    added_payload_kg=(0.0, 0.5),
    added_coulomb_friction_nm=(0.0, 0.3),
    position_noise_rad=(0.0, 3e-4),
)
"""Arms that have little more than their joints in common."""


def vary(sim: SimConfig, seed: int, variation: ArmVariation = NEAR, *, n_joints: int = 2) -> SimConfig:
    """Return a random arm like the configured one; equal arguments give equal arms.

    What the variation does not name stays. ``n_joints`` counts where ``sim`` leaves frictions to the URDF.

    Raises:
        ConfigError: the seed is negative.
    """
    if seed < 0:
        raise ConfigError("seed", seed, "a whole number of at least 0")
    # With a stream of its own: the draws are independent of what other modules draw for the same seed.
    random = np.random.default_rng((0x61726D, seed))
    viscous = sim.viscous_friction_nms_per_rad or (NOMINAL_VISCOUS_FRICTION_NMS_PER_RAD,) * n_joints
    coulomb = sim.coulomb_friction_nm or (0.0,) * len(viscous)

    def factor(limits: Range) -> float:
        return math.exp(random.uniform(math.log(limits[0]), math.log(limits[1])))

    return replace(
        sim,
        inertia_scale=sim.inertia_scale * factor(variation.inertia),
        viscous_friction_nms_per_rad=tuple(b * factor(variation.viscous_friction) for b in viscous),
        payload_kg=sim.payload_kg + random.uniform(*variation.added_payload_kg),
        coulomb_friction_nm=tuple(c + random.uniform(*variation.added_coulomb_friction_nm) for c in coulomb),
        position_noise_rad=random.uniform(*variation.position_noise_rad),
    )
