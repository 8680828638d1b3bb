"""Pack the compiled tel_interfaces and control_msgs of an environment into wheels, for environments like it.

Usage: python tools/interfaces_wheel.py FOLDER

They are compiled (rosidl, ament_cmake) and installed into this environment by `make setup`. The wheels put
the same files into another environment; they fit the Python version and the platform that they were made
with, and ROS 2 Jazzy from wheels. Beside a ROS installation, build tel_interfaces with colcon instead:
control_msgs is there.
"""

import platform
import sys
import sysconfig
from collections.abc import Iterator
from pathlib import Path
from xml.etree import ElementTree

from packaging.tags import sys_tags
from wheel.wheelfile import WheelFile

INTERFACES = Path(__file__).resolve().parent.parent / "interfaces"
PACKAGES = {"tel_interfaces": INTERFACES, "control_msgs": INTERFACES / "control_msgs"}
# The compiled libraries link with those of these packages.
REQUIRES = (
    "ros-jazzy-rclpy",
    "ros-jazzy-rmw-fastrtps-cpp",
    "ros-jazzy-std-msgs",
    "ros-jazzy-trajectory-msgs",
)


def installed_files(name: str, data: str, prefix: Path) -> Iterator[tuple[Path, str]]:
    """Yield each file of a package with its place in the wheel; ``data``: of what is not a module.

    Raises:
        FileNotFoundError: the package is not installed there.
    """
    modules = Path(sysconfig.get_path("platlib"))
    if not (modules / name).is_dir():
        raise FileNotFoundError(f"{modules / name}: not installed; run `make setup` first")
    for path in sorted((modules / name).rglob("*")):
        if path.is_file() and "__pycache__" not in path.parts:
            yield path, str(path.relative_to(modules))
    beside = [*prefix.glob(f"lib/lib{name}__*"), *prefix.glob(f"share/ament_index/*/*/{name}")]
    for folder in ("include", "share"):
        beside += [path for path in (prefix / folder / name).rglob("*") if path.is_file()]
    for path in sorted(beside):
        yield path, f"{data}/{path.relative_to(prefix)}"


def write_wheel(folder: Path, name: str) -> Path:
    """Write the wheel of a package and return its path."""
    said = ElementTree.parse(PACKAGES[name] / "package.xml")
    version, summary = (str(said.findtext(key)) for key in ("version", "description"))
    tag = str(next(tag for tag in sys_tags() if "manylinux" not in tag.platform))
    path = folder / f"{name}-{version}-{tag}.whl"
    info = f"{name}-{version}.dist-info"
    path.unlink(missing_ok=True)
    folder.mkdir(parents=True, exist_ok=True)
    python = f"=={platform.python_version_tuple()[0]}.{platform.python_version_tuple()[1]}.*"
    metadata = f"Metadata-Version: 2.1\nName: {name}\nVersion: {version}\nRequires-Python: {python}\n"
    metadata += f"Summary: {' '.join(summary.split())}\nLicense: Apache-2.0\n"
    metadata += "".join(f"Requires-Dist: {need}\n" for need in REQUIRES)
    with WheelFile(path, "w") as wheel:
        for file, place in installed_files(name, f"{name}-{version}.data/data", Path(sys.prefix)):
            wheel.write(str(file), place)
        wheel.writestr(f"{info}/METADATA", metadata)
        wheel.writestr(
            f"{info}/WHEEL",
            f"Wheel-Version: 1.0\nGenerator: tel_ros\nRoot-Is-Purelib: false\nTag: {tag}\n",
        )
    return path


def main() -> None:
    """Write them, and say where."""
    (folder,) = sys.argv[1:]
    for name in PACKAGES:
        print(write_wheel(Path(folder), name))


if __name__ == "__main__":
    main()
