#!/bin/sh
# Install software OpenGL where neither EGL nor OSMesa can be loaded.
set -eu

loads() {   # loads LIBRARY: whether the dynamic linker finds it
    "${PYTHON:-.venv/bin/python}" -c "import ctypes, sys; ctypes.CDLL(sys.argv[1])" "$1" 2>/dev/null
}

if loads libEGL.so.1 || loads libOSMesa.so.8 || loads libOSMesa.so; then exit 0; fi
sh "$(dirname "$0")/apt_install.sh" OpenGL \
    "install your system's EGL or OSMesa library, then try again" \
    libegl1 libgl1 libgl1-mesa-dri libosmesa6
