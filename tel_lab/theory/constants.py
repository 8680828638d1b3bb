"""What the theorems of [Practice] speak of, estimated trial by trial from what was recorded.

Symbols: y desired and ŷ actual motion, each (q, q̇, q̈); û = N(y) the command that was sent; u the command
that y would have needed. P is the plant, x = (q, q̇) the state, so that P(x) u = y and P(x̂) û = ŷ. Then

    R u  = u - N(y)    command error, what is to vanish; u is not known on an arm
    R̂ û = û - N(ŷ)    training error, what the network is trained with; always known

‖ ‖ is :func:`~.plant.size`. Inputs of the network are measured in units of their range, which covers
the goal movement (see :class:`~tel_ros.core.learning.inputs.InputRange`): k_N in rad a unit, k_u in units a
rad, k_x has none.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from tel_lab.theory.plant import FittedPlant, Function, plant_slopes, size, slopes, steepest
from tel_ros.core.errors import TrainingError
from tel_ros.core.learning.inputs import InputRange
from tel_ros.core.learning.learner import Learner, TrainingMode
from tel_ros.core.learning.signals import TrainingSamples, TrialSignals
from tel_ros.core.types import NS_PER_S, FloatArray

_POINTS = 200
"""Of a trial, evenly spread, that constants are estimated from."""


@dataclass(frozen=True)
class TheoryEstimate:
    """One trial in the terms of the theorems; NaN for what cannot be told.

    Args:
        alpha: practice parameter.
        tracking_error_rad: ‖q̂ - q‖, filtered as for training.
        training_error_rad: ‖R̂ û‖ with the network before training.
        command_error_rad: ‖R u‖ with the network before training.
        command_error_after_rad: ‖R u‖ with the network after training, on the same movement.
        k_r: ‖R u - R̂ û‖ / ‖u - û‖ (Theorem 1). Below 1, what the network is trained with points to where
            the error is. Meaningless once the command error has sunk to the noise of the accelerations.
        rate: γ, the share of R̂ û that training removed where it was applied, by projection.
        k_n: of the network before training, along y (A2) [rad per unit].
        k_l: of the change that training made, along y (A4) [rad per unit]. The paper's γ k_L.
        k_x: of the plant, by state, along y (A1).
        k_u: of the plant, by command, along y (A1) [units per rad].
        k_alpha: change of the needed command at equal phase since the previous trial, per change of α (A6)
            [rad]. NaN, as ``k_p``, without a previous trial or if α is the same.
        k_p: change of the motion that one and the same command makes at equal phase, per change of α (A7)
            [units].
        theorem_1: 1 - γ + γ k_R, the factor by which ‖R u‖ shrinks with desired trajectory training.
        theorem_2: the factor that Theorem 2 allows, its last term as a share of ‖R u‖.
        command_step_rad: ‖u' - u‖ = k_α |Δα| since the previous trial; as the next one, 0 if α is the same.
        step_rad: (2 k_α + k_N k_p) |Δα|, what Theorem 3 adds for that step.
        theorem_3_rad: the right-hand side of Theorem 3: k_R ‖u' - û‖ + ``step_rad``, k_R and û of the
            previous trial; for ‖u' - û‖ stands ‖u - û‖ + ‖u' - u‖.
    """

    alpha: float
    tracking_error_rad: float
    training_error_rad: float
    command_error_rad: float
    command_error_after_rad: float
    k_r: float
    rate: float
    k_n: float
    k_l: float
    k_x: float
    k_u: float
    k_alpha: float
    k_p: float
    theorem_1: float
    theorem_2: float
    command_step_rad: float
    step_rad: float
    theorem_3_rad: float

    @property
    def contraction(self) -> float:
        """The factor by which training has shrunk ‖R u‖ of this movement: what Theorems 1 and 2 bound."""
        return _ratio(self.command_error_after_rad, self.command_error_rad)


class TheoryMonitor:
    """Estimates the constants after each trial.

    The command u that y needs is not known on an arm. It is estimated as û + F(y) - F(ŷ), where F is a
    straight-line model of the inverse dynamics that is fitted to the recorded pairs (ŷ, û): only the
    *difference* of two motions is left to the model. The network after training could stand for F, but it
    underestimates its own error (docs/theory.md compares the two). The plant's constants are those of F.

    Args:
        input_range: units of the inputs.
        training: where the learner applies the training error.
        true_offset: F where it is known, as in simulation: from (q, q̇, q̈) to u - q. None: it is fitted.
    """

    def __init__(
        self, input_range: InputRange, training: TrainingMode, true_offset: Function | None = None
    ) -> None:
        self._input_range = input_range
        self._training = training
        self._true_offset = true_offset
        self._fitted = FittedPlant.unknown(input_range)
        self._unit = input_range.high - input_range.low
        self._n_joints = len(self._unit) // 3
        self._previous: tuple[TheoryEstimate, FloatArray, FloatArray] | None = None

    def after_trial(
        self,
        alpha: float,
        duration_s: float,
        signals: TrialSignals,
        samples: TrainingSamples,
        before: Learner,
        after: Learner,
    ) -> TheoryEstimate:
        """Return the estimate of one trial; trials come in the order in which they were practised.

        For a step in α, phases are compared: k_α and k_p mean something if both movements are the same part
        of a path, with the same springs.

        Args:
            alpha: practice parameter.
            duration_s: of the desired movement; an aborted trial has recorded less.
            signals: the trial as recorded; tells y at each phase.
            samples: what was made of it for training (:func:`~.signals.configured_samples`).
            before: the learner that gave the command.
            after: the learner that has learned from the trial; ``before`` again if none has.

        Raises:
            TrainingError: a sample is not finite.
        """
        rows = slice(None, None, max(1, len(samples.actual) // _POINTS))
        y, actual, offset_rad = samples.desired[rows], samples.actual[rows], samples.offset_rad[rows]
        if not all(np.all(np.isfinite(values)) for values in (y, actual, offset_rad)):
            raise TrainingError("the samples of the trial have values that are not finite")
        self._fitted = self._fitted.after(samples)
        inverse = self._command(self._true_offset or self._fitted.predict)
        network, trained = self._command(before.predict), self._command(after.predict)

        sent_rad = actual[:, : self._n_joints] + offset_rad
        needed_rad = sent_rad + inverse(y) - inverse(actual)
        training_error = sent_rad - network(actual)
        command_error = needed_rad - network(y)
        where = y if self._training == "desired" else actual
        change = trained(where) - network(where)
        rate = _ratio(float(np.sum(change * training_error)), float(np.sum(training_error**2)))
        k_r = _ratio(self._size(command_error - training_error), self._size(command_error))
        k_n = steepest(slopes(network, y, self._unit))
        k_l = steepest(slopes(lambda x: after.predict(x) - before.predict(x), y, self._unit))
        k_x, k_u = map(steepest, plant_slopes(inverse, y, self._unit))
        off_path = self._size(((y - actual) / self._unit)[:, : 2 * self._n_joints])
        theorem_1 = 1.0 - rate + rate * k_r
        time_ns, path = signals.time_ns[signals.run], signals.desired[signals.run]
        phase = (time_ns - time_ns[0]) / (NS_PER_S * duration_s)  # 0 to 1 where RUN was completed
        delta_alpha, command_rad, motion = self._step(alpha, phase, path, inverse)
        step_rad, theorem_3_rad = 2.0 * command_rad + k_n * motion, math.nan
        if self._previous is not None:
            last = self._previous[0]
            from_old_command_rad = last.command_error_rad + command_rad
            theorem_3_rad = last.k_r * from_old_command_rad + 2.0 * command_rad + k_n * motion
        estimate = TheoryEstimate(
            alpha=alpha,
            tracking_error_rad=self._size((actual - y)[:, : self._n_joints]),
            training_error_rad=self._size(training_error),
            command_error_rad=self._size(command_error),
            command_error_after_rad=self._size(needed_rad - trained(y)),
            k_r=k_r,
            rate=rate,
            k_n=k_n,
            k_l=k_l,
            k_x=k_x,
            k_u=k_u,
            k_alpha=_ratio(command_rad, delta_alpha),
            k_p=_ratio(motion, delta_alpha),
            theorem_1=theorem_1,
            theorem_2=theorem_1 + k_l * (k_u + _ratio(k_x * off_path, self._size(command_error))),
            command_step_rad=command_rad,
            step_rad=step_rad,
            theorem_3_rad=theorem_3_rad,
        )
        self._previous = (estimate, phase, path)
        return estimate

    def _command(self, offset: Function) -> Function:
        return lambda inputs: inputs[:, : self._n_joints] + offset(inputs)

    def _size(self, values: FloatArray) -> float:
        return size(values, self._n_joints)

    def _step(
        self, alpha: float, phase: FloatArray, path: FloatArray, inverse: Function
    ) -> tuple[float, float, float]:
        """Return |Δα| since the previous trial, change of needed command and of motion; NaN without one."""
        if self._previous is None:
            return math.nan, math.nan, math.nan
        last, last_phase, last_path = self._previous
        delta_alpha = abs(alpha - last.alpha)
        if delta_alpha == 0.0:
            return 0.0, 0.0, 0.0
        common = np.linspace(0.0, min(phase[-1], last_phase[-1]), _POINTS)
        y, new_y = _at(common, last_phase, last_path), _at(common, phase, path)
        change_rad = inverse(new_y) - inverse(y)
        # The old command lacks change_rad for the new motion; what that takes away is acceleration.
        _, by_command = plant_slopes(inverse, new_y, self._unit)
        lacking = np.einsum("nij,nj->ni", by_command, change_rad)
        response = (new_y - y) / self._unit - lacking
        return delta_alpha, self._size(change_rad), self._size(response)


def _at(phase: FloatArray, of: FloatArray, values: FloatArray) -> FloatArray:
    return np.column_stack([np.interp(phase, of, column) for column in values.T])


def _ratio(part: float, whole: float) -> float:
    return part / whole if whole > 0.0 else math.nan
