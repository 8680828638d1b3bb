"""The folder of a service: configuration, recordings of executions, the last networks, and the memory."""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path

import numpy as np

from tel_ros.core.config import Config
from tel_ros.core.errors import ConfigError, InputFileError
from tel_ros.core.learning.inputs import InputRange
from tel_ros.core.learning.learner import Learner
from tel_ros.core.serving.memory import ServiceMemory
from tel_ros.recording.bag_writer import UNFINISHED
from tel_ros.recording.run_folder import (
    SUMMARY_FILE,
    create_run_folder,
    network_after,
    run_lock,
    trial_bags,
    write_atomically,
    write_run_config,
    written_config,
)

MEMORY_FILE = "service.json"
LOCK_FILE = ".service.lock"
KEPT_NETWORKS = 10
_REACHED_IN_S = 0.1
"""In which a joint may get from rest to its velocity limit, for the range of accelerations of trees."""


class ServiceFolder:
    """A folder that a service goes on with whenever it is started; see :func:`open_service`."""

    def __init__(self, folder: Path, written: Config) -> None:
        self.folder, self.written = folder, written

    def memory(self) -> tuple[ServiceMemory, str]:
        """Return what the service knew when it ended, and what is wrong with that, if anything is.

        Without a memory that can be read the newest network is used. No number of an execution comes twice.
        """
        networks, problem, file = self.networks(), "", self.folder / MEMORY_FILE
        memory = ServiceMemory(network=networks[-1] if networks else 0)
        try:
            memory = ServiceMemory.from_plain(json.loads(file.read_text(encoding="utf-8")))
        except FileNotFoundError:
            pass
        except (OSError, KeyError, TypeError, ValueError) as error:
            problem = f"{file}: not readable ({error}); the newest network is used"
        unfinished = trial_bags(self.folder / UNFINISHED)
        used = [int(bag.name.partition("_")[2]) for bag in [*trial_bags(self.folder), *unfinished]]
        return replace(memory, executions=max([memory.executions, *networks, *used])), problem

    def keep(self, memory: ServiceMemory) -> None:
        """Keep the memory, the last ten networks and the last recordings.

        Raises:
            InputFileError: the disk does not take it; the earlier memory is still there.
        """
        file = self.folder / MEMORY_FILE
        try:
            write_atomically(file, json.dumps(memory.to_plain(), allow_nan=False))
            for index in self.networks()[:-KEPT_NETWORKS]:
                if index != memory.network:
                    network_after(self.folder, index).unlink(missing_ok=True)
            for bag in trial_bags(self.folder)[: -self.written.serve.bags]:
                shutil.rmtree(bag, ignore_errors=True)
        except OSError as error:
            raise InputFileError(file, f"cannot be written ({error})", "room on the disk") from error

    def networks(self) -> list[int]:
        """Return after which executions networks are kept, in order."""
        names = [file.stem.removeprefix("after_") for file in network_after(self.folder, 0).parent.glob("*")]
        return sorted(int(name) for name in names if name.isdigit())


@contextmanager
def open_service(folder: Path, config: Config) -> Iterator[ServiceFolder]:
    """Hold the folder of a service; one that does not exist is made, with the network that it begins with.

    Raises:
        ConfigError: the folder is that of an arm with other joints or springs, or the learner cannot serve.
        InputFileError: another process holds it, it is that of a practice run, or cannot be written.
    """
    if not folder.exists():
        first_network(config)  # what cannot serve leaves no folder behind
        create_run_folder(folder, config)
    with suppress(OSError):
        (folder / LOCK_FILE).touch()
    with run_lock(folder, LOCK_FILE, "service"):
        if (folder / SUMMARY_FILE).exists():
            expected = "a folder of its own (what was practised: learning.start_from)"
            raise InputFileError(folder, "is the folder of a practice run", expected)
        written = written_config(folder)
        for name in ("joints", "stiffness_nm_per_rad", "damping_nms_per_rad"):
            if (found := getattr(config.arm, name)) != (expected := getattr(written.arm, name)):
                wanted = f"{list(expected)}, as what was learned in {folder} is for"
                raise ConfigError(f"arm.{name}", list(found), wanted)
        service = ServiceFolder(folder, write_run_config(folder, config))
        if not service.networks():
            from tel_ros.recording.network_file import save_network

            save_network(first_network(config), network_after(folder, 0))
        yield service


def first_network(config: Config) -> Learner:
    """Return the learner that a service begins with: that of ``learning.start_from``, or an untrained one.

    Its input ranges are those of the arm, whatever path is configured. ConfigError: it cannot tell what
    movements need that it has not seen.
    """
    # Late: learners take long to import.
    from tel_ros.core.learning.registry import learner_kind, require_extrapolating
    from tel_ros.recording.network_file import learner_context, new_network

    because = "trajectories in service are anybody's"
    if config.learning.start_from:
        learner = new_network(config)
        require_extrapolating(learner.context.learning.name, because)
        return learner
    require_extrapolating(config.learning.name, because)
    arm = config.arm
    speed = np.array(arm.velocity_limit_rad_s)
    range_ = InputRange(
        np.concatenate([np.array(arm.position_min_rad), -speed, -speed / _REACHED_IN_S]),
        np.concatenate([np.array(arm.position_max_rad), speed, speed / _REACHED_IN_S]),
    )
    context = replace(learner_context(config), input_range=range_)
    return learner_kind(config.learning.name).new(context)
