"""The learners that come with tel_ros, under the names by which a configuration asks for them.

Each is a kind: something with ``new`` and ``restored`` that returns a :class:`~.learner.Learner`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from tel_ros.core.learning.learner import Learner, LearnerContext, StoredLearner
from tel_ros.core.learning.least_squares_learner import LeastSquaresLearner
from tel_ros.core.learning.lms_learner import LmsLearner
from tel_ros.core.learning.rigid_body_learner import RigidBodyLearner

_BASE = "base_"

Restore = Callable[[LearnerContext, StoredLearner], Learner]


def _checked(restored: Restore) -> Restore:
    """Return a function that also refuses numbers that are not finite, and says ValueError to all faults."""

    def checked(context: LearnerContext, stored: StoredLearner) -> Learner:
        for name, array in stored.arrays.items():
            if not np.all(np.isfinite(array)):
                raise ValueError(f"{name} holds numbers that are not finite")
        if not int(stored.header.get("trials_learned", -1)) >= 0:
            raise ValueError(f"trials_learned is {stored.header.get('trials_learned')}; expected at least 0")
        try:
            return restored(context, stored)
        except (KeyError, TypeError) as error:
            raise ValueError(f"the description of the learner does not fit together ({error!r})") from error

    return checked


class LmsTreeKind:
    """``lms_tree``: trees alone. ``learning.weights`` says how they learn."""

    @staticmethod
    def new(context: LearnerContext) -> Learner:
        """Return an untrained learner."""
        return _trees(context).new(context)

    @staticmethod
    @_checked
    def restored(context: LearnerContext, stored: StoredLearner) -> Learner:
        """Return a learner from its description.

        Raises:
            ValueError: the description does not fit together.
        """
        return _trees(context).restored(context, stored)


class RigidBodyKind:
    """``rigid_body``: the parameters of rigid links with friction; kinematics from the URDF."""

    @staticmethod
    def new(context: LearnerContext) -> Learner:
        """Return an untrained learner.

        Raises:
            ConfigError: Pinocchio is not installed, or cannot use the URDF.
        """
        return RigidBodyLearner.new(context)

    @staticmethod
    @_checked
    def restored(context: LearnerContext, stored: StoredLearner) -> Learner:
        """Return a learner from its description.

        Raises:
            ValueError: the description does not fit together.
        """
        return RigidBodyLearner.restored(context, stored)


class RigidBodyAndTreeKind:
    """``rigid_body+lms_tree``: trees, solved by least squares, learn what rigid links leave over."""

    @staticmethod
    def new(context: LearnerContext) -> Learner:
        """Return an untrained learner.

        Raises:
            ConfigError: Pinocchio is not installed, or cannot use the URDF.
        """
        context = _solved(context)
        return LeastSquaresLearner(context, RigidBodyLearner.new(context))

    @staticmethod
    @_checked
    def restored(context: LearnerContext, stored: StoredLearner) -> Learner:
        """Return a learner from its description.

        Raises:
            ValueError: the description does not fit together.
        """
        context = _solved(context)
        base = RigidBodyLearner.restored(
            context,
            StoredLearner(
                stored.header["base"],
                {k.removeprefix(_BASE): array for k, array in stored.arrays.items() if k.startswith(_BASE)},
            ),
        )
        return LeastSquaresLearner.restored(context, stored, base)


def _trees(context: LearnerContext) -> type[LmsLearner] | type[LeastSquaresLearner]:
    return LmsLearner if context.learning.weights == "lms" else LeastSquaresLearner


def _solved(context: LearnerContext) -> LearnerContext:
    """Return the context for trees whose weights are solved for: sample by sample is too slow for a rest."""
    return replace(context, learning=replace(context.learning, weights="least_squares"))
