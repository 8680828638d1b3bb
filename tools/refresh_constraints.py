"""Write constraints.txt anew: the newest versions of everything that go together.

Usage: python tools/refresh_constraints.py EXTRAS

Installs tel_ros with EXTRAS (separated by commas) into a temporary environment of the Python that runs this
script, and writes down what came. Afterwards `make test` should pass on both Python versions.
"""

import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent

HEADER = """\
# Exact versions of everything that `make setup` installs, for Python 3.11 and 3.12 on x86-64 Linux, so that
# it makes the same environment next year. `make constraints` writes this file anew.
"""

# Newer versions have lost what `colcon build --symlink-install` calls.
BUILD_TOOLS = ["setuptools<80", "wheel", "numpy"]
# Needed only where the system has none.
FALLBACKS = ["cmake", "ninja"]

# The ROS wheels bring package data that pip freeze would list as if it came from PyPI.
LIST_INSTALLED_BY_PIP = """
import importlib.metadata, json
print(json.dumps({
    d.metadata["Name"]: d.version for d in importlib.metadata.distributions()
    if (d.read_text("INSTALLER") or "").strip() == "pip"
}))
"""


def installed_versions(extras: str) -> dict[str, str]:
    """Return the versions that pip chooses in an empty environment, by project."""
    environment = os.environ | {"_ROS_WHEELS_BOOTSTRAP_COMPLETE": "1"}
    with tempfile.TemporaryDirectory() as folder:
        subprocess.run([sys.executable, "-m", "venv", folder], check=True)
        python = f"{folder}/bin/python"
        install = [python, "-m", "pip", "install", "--quiet", "--upgrade"]
        subprocess.run([*install, *BUILD_TOOLS], check=True, env=environment)
        # One call, so that the bounds still hold.
        everything = [*BUILD_TOOLS, *FALLBACKS, "--editable", f"{ROOT}[{extras}]"]
        subprocess.run([*install, "--no-build-isolation", *everything], check=True, env=environment)
        answer = subprocess.run(
            [python, "-c", LIST_INSTALLED_BY_PIP], check=True, env=environment, capture_output=True, text=True
        )
    versions: dict[str, str] = json.loads(answer.stdout)
    return versions


def main() -> None:
    """Install, list, write."""
    (extras,) = sys.argv[1:]
    versions = installed_versions(extras)
    for own in ("pip", "tel_ros"):
        versions.pop(own, None)
    lines = [f"{name}=={version}\n" for name, version in sorted(versions.items(), key=lambda i: i[0].lower())]
    (ROOT / "constraints.txt").write_text(HEADER + "".join(lines))
    print(f"constraints.txt: {len(lines)} projects")


if __name__ == "__main__":
    main()
