"""The folder of a practice run."""

from __future__ import annotations

import dataclasses
import errno
import json
import math
import os
import shutil
from pathlib import Path

import numpy as np
import pytest
import yaml

from tel_ros import __version__
from tel_ros.core.config import Config, PathConfig
from tel_ros.core.errors import ConfigError, InputFileError, NetworkFileError
from tel_ros.recording.bag_writer import UNFINISHED
from tel_ros.recording.config_file import load_config
from tel_ros.recording.network_file import new_network, save_network
from tel_ros.recording.run_folder import (
    CONFIG_FILE,
    NETWORK_FILE,
    SUMMARY_FILE,
    create_run_folder,
    network_after,
    open_run_folder,
    publish_network,
    read_summary,
    trial_bag,
    write_atomically,
    write_summary,
)
from tel_ros.recording.waypoint_file import load_known_path, load_path


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Where a run is to go."""
    return tmp_path / "bags" / "monday"


def without_files_and_versions(config: Config) -> Config:
    return dataclasses.replace(config, arm=dataclasses.replace(config.arm, urdf="arm.urdf"), versions={})


def test_the_configuration_of_a_run_can_be_loaded_from_its_folder(folder: Path, config: Config) -> None:
    create_run_folder(folder, config)
    again = load_config(folder / CONFIG_FILE)
    assert without_files_and_versions(again) == without_files_and_versions(config)
    assert Path(again.arm.urdf).parent == folder.resolve()


def test_a_run_can_be_moved_and_its_first_files_may_go(
    folder: Path, config: Config, config_folder: Path, tmp_path: Path
) -> None:
    waypoints = config_folder / "eight.csv"
    waypoints.write_text("shoulder,elbow\n0,0.5\n1,1\n")
    create_run_folder(folder, dataclasses.replace(config, path=PathConfig(file=str(waypoints))))
    moved = Path(shutil.move(folder, tmp_path / "archive"))
    shutil.rmtree(config_folder)
    again = load_config(moved / CONFIG_FILE)
    assert Path(again.arm.urdf).is_file()
    path = load_path(again.path, again.arm)
    np.testing.assert_allclose(path.evaluate(np.zeros(1))[0], [[0.0, 0.5]], atol=1e-12)


def test_what_is_written_names_no_place_on_this_machine(
    folder: Path, config: Config, config_folder: Path, tmp_path: Path
) -> None:
    waypoints = config_folder / "eight.csv"
    waypoints.write_text("shoulder,elbow\n0,0.5\n1,1\n")
    written = create_run_folder(folder, dataclasses.replace(config, path=PathConfig(file=str(waypoints))))
    assert (written.arm.urdf, written.path.file) == ("planar_arm.urdf", "eight.csv")
    text = (folder / CONFIG_FILE).read_text(encoding="utf-8")
    for place in (tmp_path, config_folder, Path.home(), Path.cwd()):
        assert str(place) not in text


def test_a_network_to_go_on_from_is_copied_and_found_again(
    folder: Path, config: Config, config_folder: Path, tmp_path: Path
) -> None:
    earlier = config_folder / "earlier.npz"
    save_network(new_network(config), earlier)
    learning = dataclasses.replace(config.learning, start_from=str(earlier))
    written = create_run_folder(folder, dataclasses.replace(config, learning=learning))
    earlier.unlink()
    assert written.learning.start_from == "earlier.npz"
    moved = Path(shutil.move(folder, tmp_path / "archive"))
    assert new_network(load_config(moved / CONFIG_FILE)).trials_learned == 0


def test_the_configuration_says_what_the_run_was_made_with(folder: Path, config: Config) -> None:
    create_run_folder(folder, config)
    versions = yaml.safe_load((folder / CONFIG_FILE).read_text(encoding="utf-8"))["versions"]
    assert versions["tel_ros"] == __version__
    assert versions["numpy"] == np.__version__
    assert set(versions) >= {"python", "scipy", "rosbags"}


def test_the_given_configuration_stays_as_it_was(folder: Path, config: Config) -> None:
    urdf = config.arm.urdf
    create_run_folder(folder, config)
    assert (config.arm.urdf, config.versions) == (urdf, {})


def test_a_folder_that_exists_is_refused_and_left_alone(folder: Path, config: Config) -> None:
    folder.mkdir(parents=True)
    with pytest.raises(InputFileError) as refusal:
        create_run_folder(folder, config)
    assert str(refusal.value) == f"{folder}: exists already; expected a folder that is new (option --out)"
    assert list(folder.iterdir()) == []


def test_a_folder_that_cannot_be_made_is_refused(tmp_path: Path, config: Config) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(
        InputFileError, match=r"file/run: cannot be made \(Not a directory\); expected a folder"
    ):
        create_run_folder(tmp_path / "file" / "run", config)


def test_a_new_run_is_opened_with_the_configuration_that_lies_in_its_folder(
    folder: Path, config: Config
) -> None:
    """Its files are copies under other names."""
    written = create_run_folder(folder, config)
    assert open_run_folder(folder, config) == written
    assert open_run_folder(folder, load_config(folder / CONFIG_FILE)) == written


def test_a_folder_with_another_configuration_than_the_nodes_have_is_refused(
    folder: Path, config: Config, tmp_path: Path
) -> None:
    """Its bags would tell what the run did not do."""
    create_run_folder(folder, config)
    expected = "; expected 99, as in the configuration of the nodes, or a new folder"
    with pytest.raises(InputFileError) as refusal:
        open_run_folder(folder, dataclasses.replace(config, seed=99))
    assert str(refusal.value) == f"{folder / CONFIG_FILE}: seed is {config.seed}{expected}"

    urdf = tmp_path / "other.urdf"
    urdf.write_text(Path(config.arm.urdf).read_text() + "<!-- changed -->")
    other_arm = dataclasses.replace(config.arm, urdf=str(urdf))
    with pytest.raises(
        InputFileError, match=r"run\.yaml: arm\.urdf is '.*'; expected '.*other\.urdf', as in"
    ):
        open_run_folder(folder, dataclasses.replace(config, arm=other_arm))


def test_a_missing_folder_is_made_when_it_is_opened(folder: Path, config: Config) -> None:
    opened = open_run_folder(folder, config)
    assert opened.seed == config.seed
    assert (folder / CONFIG_FILE).is_file()


def test_a_run_that_has_a_summary_is_not_run_again(folder: Path, config: Config) -> None:
    create_run_folder(folder, config)
    write_summary(folder, {})
    with pytest.raises(InputFileError, match="monday: holds something already; expected a new folder"):
        open_run_folder(folder, config)


def test_a_run_that_has_a_bag_is_not_run_again(folder: Path, config: Config) -> None:
    """It was interrupted in its first trials, before there was a summary."""
    create_run_folder(folder, config)
    trial_bag(folder, 1).mkdir()
    with pytest.raises(InputFileError, match="monday: holds something already; expected a new folder"):
        open_run_folder(folder, config)


def test_a_run_whose_first_recording_broke_off_is_not_run_again(folder: Path, config: Config) -> None:
    create_run_folder(folder, config)
    trial_bag(folder / UNFINISHED, 1).mkdir(parents=True)
    with pytest.raises(InputFileError, match="monday: holds something already; expected a new folder"):
        open_run_folder(folder, config)


def test_a_folder_of_something_else_is_not_opened(folder: Path, config: Config) -> None:
    folder.mkdir(parents=True)
    (folder / "thesis.tex").touch()
    with pytest.raises(InputFileError, match="monday: holds something already; expected a new folder"):
        open_run_folder(folder, config)


@pytest.mark.parametrize("text", ["a: [1", "", "words"])
def test_a_folder_whose_configuration_is_garbled_is_refused_by_name(
    folder: Path, config: Config, text: str
) -> None:
    create_run_folder(folder, config)
    (folder / CONFIG_FILE).write_text(text, encoding="utf-8")
    with pytest.raises((InputFileError, ConfigError), match=r"run\.yaml.*expected"):
        open_run_folder(folder, config)


def test_a_wrong_value_in_the_configuration_of_a_folder_is_refused_with_its_file(
    folder: Path, config: Config
) -> None:
    create_run_folder(folder, config)
    file = folder / CONFIG_FILE
    file.write_text(file.read_text(encoding="utf-8").replace("seed: 7", "seed: -7"), encoding="utf-8")
    with pytest.raises(ConfigError, match=r"run\.yaml: seed is -7; expected a whole number of at least 0"):
        open_run_folder(folder, config)


@pytest.mark.parametrize(("index", "name"), [(1, "trial_001"), (42, "trial_042"), (1000, "trial_1000")])
def test_bags_are_named_so_that_they_sort(tmp_path: Path, index: int, name: str) -> None:
    assert trial_bag(tmp_path, index) == tmp_path / name


def test_a_summary_comes_back_with_null_for_what_is_no_number(tmp_path: Path) -> None:
    write_summary(tmp_path, {"a": math.nan, "b": [1.5, math.inf], "c": ({"d": -math.inf}, "ü"), "e": None})
    assert read_summary(tmp_path) == {"a": None, "b": [1.5, None], "c": [{"d": None}, "ü"], "e": None}
    json.loads((tmp_path / SUMMARY_FILE).read_text(encoding="utf-8"), parse_constant=pytest.fail)


def test_a_full_disk_is_named_and_the_earlier_summary_stays(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_summary(tmp_path, {"trials": []})

    def full(descriptor: int) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(InputFileError, match="summary.json: cannot be written .*No space left on device"):
        write_summary(tmp_path, {"trials": [1]})
    assert read_summary(tmp_path) == {"trials": []}


def test_numbers_in_a_summary_keep_all_their_digits(tmp_path: Path) -> None:
    values = np.random.default_rng(0).normal(size=50).tolist()
    write_summary(tmp_path, {"values": values})
    assert read_summary(tmp_path)["values"] == values


def test_a_missing_summary_is_refused_by_name(tmp_path: Path) -> None:
    with pytest.raises(
        InputFileError, match=r"summary\.json: there is no such file; expected the folder of a"
    ):
        read_summary(tmp_path)


@pytest.mark.parametrize("content", [b"", b'{"run": ', b"\xff\xfe"])
def test_a_garbled_summary_is_refused_by_name(tmp_path: Path, content: bytes) -> None:
    (tmp_path / SUMMARY_FILE).write_bytes(content)
    with pytest.raises(
        InputFileError, match=r"summary\.json: not readable .*; expected the summary of a practice"
    ):
        read_summary(tmp_path)


def test_a_write_that_fails_leaves_the_old_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file = tmp_path / "file.json"
    write_atomically(file, "old")

    def full(*_: object) -> None:
        raise OSError("disk full")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(OSError, match="disk full"):
        write_atomically(file, "new, but only half of")
    assert file.read_text() == "old"


def test_a_network_that_the_disk_does_not_take_is_told_by_the_name_of_its_file(tmp_path: Path) -> None:
    """What ends a run has to be an error of ours: the practice manager would never be free again."""
    network_after(tmp_path, 1).parent.mkdir()
    network_after(tmp_path, 1).write_text("network")
    publish_network(tmp_path, 1)
    (tmp_path / NETWORK_FILE).unlink()
    (tmp_path / NETWORK_FILE / "in the way").mkdir(parents=True)
    with pytest.raises(NetworkFileError, match=r"network\.npz: cannot be written"):
        publish_network(tmp_path, 1)


def test_a_write_leaves_nothing_but_the_file(tmp_path: Path) -> None:
    write_atomically(tmp_path / "file.json", "old")
    write_atomically(tmp_path / "file.json", "new")
    assert [path.name for path in tmp_path.iterdir()] == ["file.json"]
    assert (tmp_path / "file.json").read_text() == "new"


def test_the_known_path_is_copied_beside_the_goals_even_if_both_files_have_one_name(
    folder: Path, config: Config, config_folder: Path
) -> None:
    (config_folder / "known").mkdir()
    goal, known = config_folder / "path.csv", config_folder / "known" / "path.csv"
    goal.write_text("shoulder,elbow\n0,0.5\n1,1\n")
    known.write_text("shoulder,elbow\n0.25,0.75\n0.5,1\n")
    varied = dataclasses.replace(
        config,
        path=PathConfig(file=str(goal), known_file=str(known)),
        practice=dataclasses.replace(config.practice, vary=("shape",)),
    )
    create_run_folder(folder, varied)
    shutil.rmtree(config_folder)
    again = load_config(folder / CONFIG_FILE)
    path, known_path = load_path(again.path, again.arm), load_known_path(again.path, again.arm)
    assert known_path is not None
    np.testing.assert_allclose(path.evaluate(np.zeros(1))[0], [[0.0, 0.5]], atol=1e-12)
    np.testing.assert_allclose(known_path.evaluate(np.zeros(1))[0], [[0.25, 0.75]], atol=1e-12)
