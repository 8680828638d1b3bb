"""A comparison that nobody had to wait for."""

from __future__ import annotations

from tel_lab.comparison.method_runs import Comparison
from tel_lab.comparison.methods import METHODS
from tel_lab.comparison.results import MethodRun, TrialResult

N_ARMS = 10


def trial(rms_rad: float, *, largest_rad: float = 0.2, completed: bool = True) -> TrialResult:
    return TrialResult(4.5, completed, rms_rad, largest_rad, arm_s=7.0)


def run(
    method: str, seed: int, final_rad: float, *, new_rad: float | None, completed: bool = True
) -> MethodRun:
    """Return a run of two trials: 100 mrad, then the error that is left."""
    largest_rad = 0.2 if completed else 1.1
    return MethodRun(
        method=method,
        seed=seed,
        goal_duration_s=4.5,
        tolerance_rad=5e-3,
        trials=(trial(0.1), trial(final_rad, largest_rad=largest_rad, completed=completed)),
        final=trial(final_rad, completed=completed),
        bound_s=1.5,
        new_path=None if new_rad is None else trial(new_rad, completed=completed),
        cpu_s=0.5,
        message="said, by the strategy",
    )


def made_up_comparison() -> Comparison:
    """Five methods on ten arms; the final errors of each grow a little from arm to arm."""

    def runs(method: str, final_rad: float, **more: object) -> tuple[MethodRun, ...]:
        return tuple(run(method, k, final_rad * (1.0 + 0.01 * k), **more) for k in range(1, N_ARMS + 1))

    table = {
        "no_learning": runs("no_learning", 0.1, new_rad=0.2),
        "tel_adaptive_least_squares": runs("tel_adaptive_least_squares", 1e-3, new_rad=0.02),
        "direct_desired": runs("direct_desired", 0.3, new_rad=0.3, completed=False),
        "iterative_learning": runs("iterative_learning", 0.5e-3, new_rad=None),
        "exact_model": runs("exact_model", 0.2e-3, new_rad=1e-3),
    }
    specs = tuple(METHODS[name] for name in table)
    return Comparison(specs, table, wall_s=10.0)
