"""Learners by name: ours in :data:`OURS`, others as entry points of the group :data:`GROUP`."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import numpy as np

from tel_ros.core.errors import ConfigError
from tel_ros.core.learning.learner import Learner, LearnerContext, LearnerKind, StoredLearner
from tel_ros.core.learning.least_squares_learner import BASE, LeastSquaresLearner
from tel_ros.core.learning.lms_learner import LmsLearner
from tel_ros.core.learning.polynomial import PolynomialLearner
from tel_ros.core.learning.rigid_body import RigidBodyLearner
from tel_ros.core.plugins import plugin

GROUP = "tel_ros.learners"


@dataclass(frozen=True)
class OurKind:
    """A :class:`~.learner.LearnerKind` of ours: ``make`` also returns the learner that is described."""

    make: Callable[[LearnerContext, StoredLearner | None], Learner]
    extrapolates: bool = False
    """Whether what it predicts goes with q̈ and with the square of q̇ as in rigid bodies, however fast."""

    def new(self, context: LearnerContext) -> Learner:
        """See :meth:`.learner.LearnerKind.new`."""
        return self.make(context, None)

    def restored(self, context: LearnerContext, stored: StoredLearner) -> Learner:
        """See :meth:`.learner.LearnerKind.restored`."""
        for name, array in stored.arrays.items():
            if not np.all(np.isfinite(array)):
                raise ValueError(f"{name} holds numbers that are not finite")
        if not int(stored.header.get("trials_learned", -1)) >= 0:
            raise ValueError(f"trials_learned is {stored.header.get('trials_learned')}; expected at least 0")
        try:
            return self.make(context, stored)
        except (KeyError, TypeError) as error:
            raise ValueError(f"the description of the learner does not fit together ({error!r})") from error


def _trees(context: LearnerContext, stored: StoredLearner | None) -> Learner:
    kind = LmsLearner if context.learning.weights == "lms" else LeastSquaresLearner
    return kind.restored(context, stored) if stored else kind(context)


def _rigid_body(context: LearnerContext, stored: StoredLearner | None) -> RigidBodyLearner:
    return RigidBodyLearner.restored(context, stored) if stored else RigidBodyLearner(context)


def _polynomial(context: LearnerContext, stored: StoredLearner | None) -> PolynomialLearner:
    return PolynomialLearner.restored(context, stored) if stored else PolynomialLearner(context)


def _rigid_body_and_tree(context: LearnerContext, stored: StoredLearner | None) -> Learner:
    # Sample by sample is too slow for a rest.
    context = replace(context, learning=replace(context.learning, weights="least_squares"))
    if stored is None:
        return LeastSquaresLearner(context, _rigid_body(context, None))
    of_base = {k.removeprefix(BASE): array for k, array in stored.arrays.items() if k.startswith(BASE)}
    base = _rigid_body(context, StoredLearner(stored.header["base"], of_base))
    return LeastSquaresLearner.restored(context, stored, base)


OURS: dict[str, LearnerKind] = {
    # Trees alone. ``learning.weights`` says how they learn.
    "lms_tree": OurKind(_trees),
    # Polynomials for the energies of rigid links, with friction; no kinematics.
    "polynomial": OurKind(_polynomial, extrapolates=True),
    # The parameters of rigid links with friction; kinematics from the URDF.
    "rigid_body": OurKind(_rigid_body, extrapolates=True),
    # Trees, solved by least squares, learn what rigid links leave over.
    "rigid_body+lms_tree": OurKind(_rigid_body_and_tree),
}


def require_extrapolating(
    name: str, because: str = "practice.goal is 'fastest': it has to know what faster movements need"
) -> None:
    """Refuse a learner that cannot tell what other movements need than those that it has seen.

    A kind of another package tells by an attribute ``extrapolates``. ``because``: why it has to, for people.

    Raises:
        ConfigError: it cannot, or is not known.
    """
    if not getattr(learner_kind(name), "extrapolates", False):
        able = " or ".join(ours for ours, kind in OURS.items() if getattr(kind, "extrapolates", False))
        raise ConfigError("learning.name", name, f"{able}, because {because}")


@cache
def learner_kind(name: str) -> LearnerKind:
    """Return the kind of learner with a name: one of ours, or an entry point of an installed package.

    Raises:
        ConfigError: the name is not known, or what an entry point names cannot be loaded.
    """

    def made(found: Any) -> Any:
        return found() if isinstance(found, type) else found

    return plugin("learning.name", name, GROUP, OURS, ("new", "restored"), made)
