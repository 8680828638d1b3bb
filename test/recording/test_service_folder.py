"""What a service finds again when it is started in its folder."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tel_ros.core.config import Config
from tel_ros.core.errors import ConfigError, InputFileError
from tel_ros.core.serving.memory import Remembered, ServiceMemory
from tel_ros.recording.config_file import load_config
from tel_ros.recording.network_file import load_network
from tel_ros.recording.run_folder import network_after, trial_bag
from tel_ros.recording.service_folder import MEMORY_FILE, open_service

PLANAR = Path(__file__).parents[2] / "config" / "planar_arm.yaml"


@pytest.fixture(scope="module")
def config() -> Config:
    return load_config(PLANAR, ["learning.name=rigid_body", "serve.bags=2"])


def test_a_new_folder_begins_with_an_untrained_network_of_the_whole_arm(
    tmp_path: Path, config: Config
) -> None:
    with open_service(tmp_path / "cell", config) as service:
        assert service.memory() == (ServiceMemory(), "")
        network = load_network(network_after(service.folder, 0))
    assert network.trials_learned == 0
    assert tuple(network.context.input_range.high[:2]) == config.arm.position_max_rad
    np.testing.assert_array_equal(network.context.input_range.high[2:4], config.arm.velocity_limit_rad_s)


def test_memory_comes_back_and_no_number_of_an_execution_comes_twice(tmp_path: Path, config: Config) -> None:
    memory = ServiceMemory(3, 2, 1.5, {"a": Remembered(1e-3, 1.0, 2)})
    with open_service(tmp_path / "cell", config) as service:
        service.keep(memory)
        trial_bag(service.folder, 4).mkdir()
    with open_service(tmp_path / "cell", config) as service:
        assert service.memory() == (replace(memory, executions=4), "")
        trial_bag(service.folder / ".unfinished", 7).mkdir(parents=True)
        assert service.memory()[0].executions == 7


def test_a_broken_memory_is_told_and_the_newest_network_is_used(tmp_path: Path, config: Config) -> None:
    with open_service(tmp_path / "cell", config) as service:
        network_after(service.folder, 5).write_bytes(b"")
        for text in (
            "{",
            '{"executions": 1}',
            '{"executions": 1, "network": 1, "ratio": -1, "movements": {}}',
        ):
            (service.folder / MEMORY_FILE).write_text(text)
            memory, problem = service.memory()
            assert (memory.network, memory.executions) == (5, 5)
            assert MEMORY_FILE in problem


def test_the_last_networks_and_recordings_are_kept_and_the_one_in_use(tmp_path: Path, config: Config) -> None:
    with open_service(tmp_path / "cell", config) as service:
        for index in range(1, 15):
            network_after(service.folder, index).write_bytes(b"")
            trial_bag(service.folder, index).mkdir()
        service.keep(ServiceMemory(14, 3))
        assert service.networks() == [3, *range(5, 15)]
        assert not trial_bag(service.folder, 12).exists() and trial_bag(service.folder, 13).exists()


def test_a_disk_that_is_full_leaves_the_earlier_memory(
    tmp_path: Path, config: Config, monkeypatch: pytest.MonkeyPatch
) -> None:
    with open_service(tmp_path / "cell", config) as service:
        service.keep(ServiceMemory(1, 0))

        def full(*_: object) -> None:
            raise OSError(28, "No space left on device")

        monkeypatch.setattr("os.fsync", full)
        with pytest.raises(InputFileError, match="No space left"):
            service.keep(ServiceMemory(2, 0))
        assert service.memory()[0].executions == 1


def test_another_arm_another_process_and_a_practice_run_are_refused(tmp_path: Path, config: Config) -> None:
    folder = tmp_path / "cell"
    with open_service(folder, config):  # noqa: SIM117 - one holds it, the other is refused
        with pytest.raises(InputFileError, match="a service is under way"), open_service(folder, config):
            pass
    stiffer = replace(config, arm=replace(config.arm, stiffness_nm_per_rad=(30.0, 15.0)))
    with pytest.raises(ConfigError, match="stiffness_nm_per_rad"), open_service(folder, stiffer):
        pass
    (folder / "summary.json").write_text("{}")
    with pytest.raises(InputFileError, match="practice run"), open_service(folder, config):
        pass


def test_values_that_do_not_concern_what_was_learned_may_change(tmp_path: Path, config: Config) -> None:
    with open_service(tmp_path / "cell", config):
        pass
    changed = replace(config, serve=replace(config.serve, tolerance_rad=0.02))
    with open_service(tmp_path / "cell", changed) as service:
        assert service.written.serve.tolerance_rad == 0.02


def test_a_learner_that_knows_only_what_it_has_seen_cannot_serve(tmp_path: Path, config: Config) -> None:
    tree = replace(config, learning=replace(config.learning, name="lms_tree"))
    refused = pytest.raises(ConfigError, match=r"learning\.name is 'lms_tree'; expected .*in service")
    with refused, open_service(tmp_path / "cell", tree):
        pass
    assert not (tmp_path / "cell").exists()
