#!/bin/sh
# Install software OpenGL where neither EGL nor OSMesa can be loaded. Asks no question.
set -eu

packages="libegl1 libgl1 libgl1-mesa-dri libosmesa6"

loads() {   # loads LIBRARY: whether the dynamic linker finds it
    "${PYTHON:-.venv/bin/python}" -c "import ctypes, sys; ctypes.CDLL(sys.argv[1])" "$1" 2>/dev/null
}

if loads libEGL.so.1 || loads libOSMesa.so.8 || loads libOSMesa.so; then exit 0; fi

if [ "$(id -u)" = 0 ]; then sudo=""
elif sudo -n true 2>/dev/null; then sudo="sudo -n"
else
    echo "No OpenGL found: install it with 'sudo apt-get install $packages' (or your system's EGL or OSMesa), then try again." >&2
    exit 2
fi
if ! command -v apt-get >/dev/null; then
    echo "No OpenGL found and no apt-get here: install your system's EGL or OSMesa library, then try again." >&2
    exit 2
fi
echo "Installing software OpenGL: $packages"
$sudo apt-get -qq update
$sudo env DEBIAN_FRONTEND=noninteractive apt-get -qq -y install --no-install-recommends $packages >/dev/null
