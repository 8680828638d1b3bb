"""Pack the compiled tel_interfaces of an environment into a wheel, for environments like it.

Usage: python tools/interfaces_wheel.py FOLDER

tel_interfaces is compiled (rosidl, ament_cmake) and installed into this environment by `make setup`. The
wheel puts the same files into another environment; it fits the Python version and the platform that it was
made with, and ROS 2 Jazzy from wheels. Beside a ROS installation, build the package with colcon instead.
"""

import platform
import sys
import sysconfig
from collections.abc import Iterator
from pathlib import Path

from packaging.tags import sys_tags
from wheel.wheelfile import WheelFile

NAME = "tel_interfaces"
ROOT = Path(__file__).resolve().parent.parent
# The compiled libraries link with those of these packages.
REQUIRES = (
    "ros-jazzy-rclpy",
    "ros-jazzy-rmw-fastrtps-cpp",
    "ros-jazzy-std-msgs",
    "ros-jazzy-trajectory-msgs",
)


def installed_files(prefix: Path) -> Iterator[tuple[Path, str]]:
    """Yield each file of the package with its place in the wheel.

    Raises:
        FileNotFoundError: the package is not installed there.
    """
    modules = Path(sysconfig.get_path("platlib"))
    if not (modules / NAME).is_dir():
        raise FileNotFoundError(f"{modules / NAME}: not installed; run `make setup` first")
    data = f"{NAME}-{version()}.data/data"
    for path in sorted((modules / NAME).rglob("*")):
        if path.is_file() and "__pycache__" not in path.parts:
            yield path, str(path.relative_to(modules))
    beside = [*prefix.glob(f"lib/lib{NAME}__*"), *prefix.glob(f"share/ament_index/*/*/{NAME}")]
    for folder in ("include", "share"):
        beside += [path for path in (prefix / folder / NAME).rglob("*") if path.is_file()]
    for path in sorted(beside):
        yield path, f"{data}/{path.relative_to(prefix)}"


def version() -> str:
    """Return the version of tel_ros, which the interfaces share."""
    namespace: dict[str, str] = {}
    exec((ROOT / "tel_ros" / "__init__.py").read_text(), namespace)
    return namespace["__version__"]


def write_wheel(folder: Path) -> Path:
    """Write the wheel and return its path."""
    tag = str(next(tag for tag in sys_tags() if "manylinux" not in tag.platform))
    path = folder / f"{NAME}-{version()}-{tag}.whl"
    info = f"{NAME}-{version()}.dist-info"
    path.unlink(missing_ok=True)
    folder.mkdir(parents=True, exist_ok=True)
    python = f"=={platform.python_version_tuple()[0]}.{platform.python_version_tuple()[1]}.*"
    metadata = f"Metadata-Version: 2.1\nName: {NAME}\nVersion: {version()}\nRequires-Python: {python}\n"
    metadata += "Summary: The compiled ROS 2 interfaces of tel_ros.\nLicense: Apache-2.0\n"
    metadata += "".join(f"Requires-Dist: {name}\n" for name in REQUIRES)
    with WheelFile(path, "w") as wheel:
        for file, place in installed_files(Path(sys.prefix)):
            wheel.write(str(file), place)
        wheel.writestr(f"{info}/METADATA", metadata)
        wheel.writestr(
            f"{info}/WHEEL",
            f"Wheel-Version: 1.0\nGenerator: tel_ros\nRoot-Is-Purelib: false\nTag: {tag}\n",
        )
    return path


def main() -> None:
    """Write it, and say where."""
    (folder,) = sys.argv[1:]
    print(write_wheel(Path(folder)))


if __name__ == "__main__":
    main()
