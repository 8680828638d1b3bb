"""What is stored beside the messages of a trial, so that its bag explains itself."""

from __future__ import annotations

from tel_ros.core.config import Config
from tel_ros.core.practice.decisions import PlannedTrial
from tel_ros.recording.config_file import dump_config
from tel_ros.recording.provenance import stored_files

GO_BACK_TO = "go_back_to"
"""The trial whose network was gone back to before this one; empty: none."""
REVISION = "network_revision"
"""Of the network that has said what to command."""


def trial_metadata(plan: PlannedTrial, config: Config, written: Config, revision: str) -> dict[str, str]:
    """Return the custom data of a trial's bag: all that it takes to plan, repeat and learn from the trial.

    Args:
        plan: of the trial.
        config: of the run, with files that can be read.
        written: the same as it is written in the run's folder.
        revision: of the network that has said what to command.
    """
    return {
        "config": dump_config(written),
        "strategy": config.practice.strategy,
        "trial": str(plan.index),
        "alpha": repr(plan.alpha),
        "duration_s": repr(plan.movement.own_duration_s),
        "reason": plan.reason,
        "seed": str(config.seed),
        GO_BACK_TO: "" if plan.go_back_to is None else str(plan.go_back_to),
        REVISION: revision,
        **{f"version.{name}": version for name, version in written.versions.items()},
        **stored_files(config, plan.index),
    }
