#!/usr/bin/env bash
# Usage: tools/build_interfaces.sh VENV
# Builds tel_interfaces, and control_msgs where there is none, against the ROS wheels of a virtual environment
# and installs them into the same environment, where Python finds them without sourcing anything.
set -euo pipefail

root=$(cd "$(dirname "$0")/.." && pwd)
venv=$(cd "$1" && pwd)
# The ROS wheels restart Python to extend LD_LIBRARY_PATH unless this is set. Building needs none of
# their libraries, and compilers should not see them.
export _ROS_WHEELS_BOOTSTRAP_COMPLETE=1
# What a sourced setup file would say.
export AMENT_PREFIX_PATH=$venv CMAKE_PREFIX_PATH=$venv PATH=$venv/bin:$PATH
export ROS_VERSION=2 ROS_PYTHON_VERSION=3 ROS_DISTRO=jazzy
# cmake runs a build of its own: it is not part of the make above it.
unset MAKEFLAGS MAKELEVEL MFLAGS

cmake_is_recent() {
    cmake --version 2>/dev/null | "$venv/bin/python" -c '
import re, sys
match = re.search(r"(\d+)\.(\d+)", sys.stdin.readline())
sys.exit(match is None or (int(match[1]), int(match[2])) < (3, 22))'
}

wanted=()
cmake_is_recent || wanted+=(cmake)
ninja --version >/dev/null 2>&1 || wanted+=(ninja)
if [ ${#wanted[@]} -gt 0 ]; then
    "$venv/bin/python" -m pip install --quiet --constraint "$root/constraints.txt" "${wanted[@]}"
    hash -r
fi

mkdir -p "$venv/build"

# Usage: install_package SOURCE NAME
install_package() {
    local source=$1 name=$2 build=$venv/build/$2 log=$venv/build/$2.log
    quietly() {
        "$@" >"$log" 2>&1 || {
            cat "$log" >&2
            echo "make setup: $name could not be built (see above)" >&2
            exit 1
        }
    }
    rm -rf "$build"
    mkdir -p "$build"
    quietly cmake -S "$source" -B "$build" -G Ninja \
        -DCMAKE_BUILD_TYPE=Release \
        -DCMAKE_INSTALL_PREFIX="$venv" \
        -DCMAKE_PROJECT_INCLUDE="$root/tools/wheel_include_paths.cmake" \
        -DPython3_EXECUTABLE="$venv/bin/python" \
        -DBUILD_TESTING=OFF
    quietly cmake --build "$build"
    # Installing adds and replaces; an interface that is gone must not linger.
    rm -rf "$venv"/{include,share}/"$name" "$venv"/lib/lib"${name}"__* \
        "$venv"/lib/python3.*/site-packages/"$name"{,-*}
    quietly cmake --install "$build"
    rm -rf "$build"
}

install_package "$root/interfaces" tel_interfaces
# The real one has more in it, and stays; one that was built here before is built anew.
control_msgs=$venv/share/control_msgs
if [ ! -e "$control_msgs" ] || [ ! -e "$control_msgs/msg/DynamicJointState.msg" ]; then
    install_package "$root/interfaces/control_msgs" control_msgs
fi
