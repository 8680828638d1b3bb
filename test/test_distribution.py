"""What is handed to others is whole: one version, and a wheel that has in it what the program looks for."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import zipfile
from email.parser import Parser
from pathlib import Path
from xml.etree import ElementTree

import pytest
import yaml

import tel_ros

ROOT = Path(__file__).parents[1]


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> zipfile.ZipFile:
    """Build the wheel as pip does, with the tools that are there: nothing is fetched."""
    pytest.importorskip("build")
    folder = tmp_path_factory.mktemp("dist")
    sources = folder / "sources"
    # A copy, because setuptools leaves its traces where it builds; links would let it write through.
    subprocess.run(
        [sys.executable, "-c", _COPY, str(ROOT), str(sources)], check=True, capture_output=True, timeout=100
    )
    command = [sys.executable, "-m", "build", "--wheel", "--no-isolation", "--outdir", str(folder)]
    run = subprocess.run([*command, str(sources)], capture_output=True, text=True, timeout=400)
    assert run.returncode == 0, run.stdout + run.stderr
    (file,) = folder.glob("*.whl")
    return zipfile.ZipFile(file)


_COPY = """
import shutil, sys
for name in ("tel_ros", "sim_bridge", "tel_lab", "config", "launch", "resource"):
    shutil.copytree(f"{sys.argv[1]}/{name}", f"{sys.argv[2]}/{name}")
for name in ("setup.py", "setup.cfg", "pyproject.toml", "package.xml", "README.md", "LICENSE", "MANIFEST.in"):
    shutil.copy(f"{sys.argv[1]}/{name}", sys.argv[2])
"""


@pytest.mark.timeout(600)
def test_the_wheel_has_every_module_configuration_description_and_launch_file(wheel: zipfile.ZipFile) -> None:
    names = set(wheel.namelist())
    code = {
        str(path.relative_to(ROOT))
        for package in ("tel_ros", "sim_bridge", "tel_lab")
        for path in (ROOT / package).rglob("*")
        if path.is_file() and "__pycache__" not in path.parts
    }
    data = {
        f"tel_ros-{tel_ros.__version__}.data/data/share/tel_ros/{path.relative_to(ROOT)}"
        for folder in ("config", "launch", "sim_bridge/urdf")
        for path in (ROOT / folder).rglob("*")
        if path.is_file() and "__pycache__" not in path.parts
    }
    assert code - names == set()
    assert data - names == set()
    assert len(data) > 15  # the pattern still finds them


@pytest.mark.timeout(600)
def test_the_wheel_offers_tel_and_says_what_it_needs(wheel: zipfile.ZipFile) -> None:
    info = f"tel_ros-{tel_ros.__version__}.dist-info"
    assert "tel = tel_ros.app.cli:main" in wheel.read(f"{info}/entry_points.txt").decode()
    metadata = Parser().parsestr(wheel.read(f"{info}/METADATA").decode())
    assert metadata["Version"] == tel_ros.__version__
    assert set(metadata.get_all("Provides-Extra") or ()) >= {"ros", "sim", "report", "docs"}
    # The name is free on the public index: whoever took it would be installed.
    assert not any(need.startswith("tel") for need in metadata.get_all("Requires-Dist") or ())


@pytest.mark.timeout(300)
def test_the_wheels_of_the_interfaces_have_modules_libraries_and_index(tmp_path: Path) -> None:
    pytest.importorskip("tel_interfaces")
    if sys.prefix == sys.base_prefix:
        pytest.skip("made from a virtual environment; a ROS installation builds the package with colcon")
    command = [sys.executable, str(ROOT / "tools" / "interfaces_wheel.py"), str(tmp_path)]
    run = subprocess.run(command, capture_output=True, text=True, timeout=250)
    assert run.returncode == 0, run.stderr
    folders = {"tel_interfaces": ROOT / "interfaces", "control_msgs": ROOT / "interfaces" / "control_msgs"}
    for (name, source), wheel in zip(folders.items(), run.stdout.split(), strict=True):
        names = zipfile.ZipFile(wheel).namelist()
        version = ElementTree.parse(source / "package.xml").findtext("version")
        data = f"{name}-{version}.data/data"
        for file in (file for kind in ("action", "msg", "srv") for file in source.glob(f"{kind}/*")):
            assert f"{data}/share/{name}/{file.relative_to(source)}" in names
        assert f"{data}/lib/lib{name}__rosidl_typesupport_fastrtps_c.so" in names
        assert f"{data}/share/ament_index/resource_index/packages/{name}" in names
        assert f"{name}/msg/__init__.py" in names


def test_the_version_is_the_same_wherever_it_is_written() -> None:
    written = {
        "package.xml": ElementTree.parse(ROOT / "package.xml").findtext("version"),
        "interfaces/package.xml": ElementTree.parse(ROOT / "interfaces" / "package.xml").findtext("version"),
        "CITATION.cff": yaml.safe_load((ROOT / "CITATION.cff").read_text())["version"],
        "CHANGELOG.md": re.findall(r"^## (\S+)", (ROOT / "CHANGELOG.md").read_text(), flags=re.MULTILINE)[0],
    }
    assert written == dict.fromkeys(written, tel_ros.__version__)
    assert re.fullmatch(r"\d+\.\d+\.\d+", tel_ros.__version__)


def test_set_up_works_through_links_from_another_folder(tmp_path: Path) -> None:
    """As ``colcon build --symlink-install`` runs it."""
    for name in ("setup.py", "setup.cfg", "tel_ros", "sim_bridge", "tel_lab", "package.xml"):
        (tmp_path / name).symlink_to(ROOT / name)
    command = [sys.executable, "setup.py", "--version"]
    run = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=60)
    assert (run.stdout.strip(), run.stderr) == (tel_ros.__version__, "")


@pytest.mark.skipif(shutil.which("colcon") is None, reason="needs colcon")
@pytest.mark.parametrize("options", [(), ("--symlink-install",)])
@pytest.mark.timeout(300)
def test_colcon_builds_without_a_word_on_stderr(tmp_path: Path, options: tuple[str, ...]) -> None:
    shutil.copytree(ROOT, tmp_path / "src", ignore=shutil.ignore_patterns(*_MADE_HERE))
    shutil.copytree(ROOT / "bags" / "sample_run", tmp_path / "src" / "bags" / "sample_run")
    command = ["colcon", "build", "--base-paths", "src", "--packages-select", "tel_ros", *options]
    run = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=250, env=_COMPILING)
    assert run.returncode == 0, run.stdout + run.stderr
    assert (tmp_path / "log" / "latest_build" / "tel_ros" / "stderr.log").read_text() == ""
    assert (tmp_path / "install" / "tel_ros" / "lib" / "tel_ros" / "practice_manager").is_file()


_MADE_HERE = (".*", "bags", "build", "dist", "install", "log", "site", "*.egg-info", "__pycache__")
_COMPILING = {key: value for key, value in os.environ.items() if key != "PYTHONDONTWRITEBYTECODE"}
"""An environment in which Python may write what it compiles: setuptools complains where it may not."""


def test_the_citation_names_the_paper_and_the_software() -> None:
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text())
    for key in ("cff-version", "message", "title", "authors", "license"):
        assert citation[key]
    paper = citation["preferred-citation"]
    assert (paper["title"], paper["year"]) == ("A Practice Strategy for Robot Learning Control", 1992)


def test_all_tests_can_be_collected_in_one_session() -> None:
    """As ``colcon test`` does it: pytest imports test files by their names alone, without their folders."""
    files = [path.name for path in (ROOT / "test").rglob("*.py") if path.name != "conftest.py"]
    assert sorted({name for name in files if files.count(name) > 1}) == []
