#!/usr/bin/env bash
# Installs what the tests need: Debian packages where that is allowed, Python packages in .venv.
set -euo pipefail
cd "$(dirname "$0")/.."

# The commands that come from Debian packages, and the packages.
declare -A packages=([cc]=build-essential [python3]=python3 [pkg-config]=pkg-config [cmake]=cmake [valgrind]=valgrind [strace]=strace)
missing=()
for command in "${!packages[@]}"; do
    command -v "$command" >/dev/null || missing+=("${packages[$command]}")
done
python3 -c 'import venv, ensurepip' 2>/dev/null || missing+=(python3-venv)
pkg-config --exists OpenImageIO 2>/dev/null || missing+=(libopenimageio-dev)
# Libraries that Blender's Python module loads.
declare -A libraries=([libGL.so.1]=libgl1 [libICE.so.6]=libice6 [libSM.so.6]=libsm6 [libXfixes.so.3]=libxfixes3 [libXi.so.6]=libxi6
    [libxkbcommon.so.0]=libxkbcommon0 [libXrender.so.1]=libxrender1)
for library in "${!libraries[@]}"; do
    /sbin/ldconfig -p | grep -qF "$library" || missing+=("${libraries[$library]}")
done
if [ ${#missing[@]} -gt 0 ]; then
    if [ "$(id -u)" = 0 ] || [ "${CI:-}" = true ]; then
        sudo=""
        [ "$(id -u)" = 0 ] || sudo="sudo -n"
        $sudo apt-get update -qq
        $sudo apt-get install -y -qq "${missing[@]}"
    else
        echo "Missing packages; install them with: sudo apt-get install ${missing[*]}" >&2
        exit 1
    fi
fi

# A virtual environment with the packages of a requirements file, made anew where the file has changed.
environment() {
    local folder=$1 requirements=$2 python=${3:-python3}
    cmp -s "$requirements" "$folder/requirements.txt" && return
    [ -x "$folder/bin/python" ] || "$python" -m venv "$folder"
    "$folder/bin/pip" install --quiet --disable-pip-version-check -r "$requirements"
    cp "$requirements" "$folder/requirements.txt"
}
environment .venv tests/python/requirements.txt
environment .venv/numpy1 tests/python/requirements-numpy1.txt
# Blender's module is for Python 3.11 only.
if ! command -v python3.11 >/dev/null; then
    echo "Missing: python3.11, for Blender's Python module (bpy 5.0.1)" >&2
    exit 1
fi
environment .venv/blender tests/blender/requirements.txt python3.11
