#!/usr/bin/env bash
# Usage: tools/create_venv.sh PYTHON VENV
# Makes an empty virtual environment, after checking that this machine can build what goes into it.
set -euo pipefail

python=$1
venv=$2

fail() {
    echo "make setup: $*" >&2
    exit 1
}

command -v "$python" >/dev/null || fail "there is no '$python' here; name a Python 3.11 or 3.12 with PYTHON=/path/to/python3"

version=$("$python" -c 'import sys; print("%d.%d" % sys.version_info[:2])') || fail "'$python' does not run"
case $version in
    3.11 | 3.12) ;;
    *) fail "'$python' is Python $version, but ROS 2 Jazzy needs 3.11 or 3.12; choose another with PYTHON=python3.12" ;;
esac

"$python" -c 'import ensurepip, venv' 2>/dev/null ||
    fail "'$python' cannot make virtual environments; on Debian and Ubuntu: sudo apt install python$version-venv"

# CMake looks for these; asking here gives one line instead of a page.
command -v "${CXX:-c++}" >/dev/null || command -v g++ >/dev/null || command -v clang++ >/dev/null ||
    fail "there is no C++ compiler here; on Debian and Ubuntu: sudo apt install g++"
command -v "${CC:-cc}" >/dev/null || command -v gcc >/dev/null || command -v clang >/dev/null ||
    fail "there is no C compiler here; on Debian and Ubuntu: sudo apt install gcc"

headers=$("$python" -c 'import sysconfig; print(sysconfig.get_path("include"))')
[ -e "$headers/Python.h" ] ||
    fail "'$python' comes without its C headers; on Debian and Ubuntu: sudo apt install python$version-dev"

rm -rf "$venv"
"$python" -m venv "$venv"
