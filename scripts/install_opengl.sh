#!/bin/sh
# install_opengl.sh [both]: install software OpenGL where neither EGL nor OSMesa can be loaded.
# With "both" also what is missing of the two, since a test compares their pictures; newer systems
# have no OSMesa any more, so that without it the tests go on and skip that comparison.
set -eu

loads() {   # loads LIBRARY: whether the dynamic linker finds it
    "${PYTHON:-.venv/bin/python}" -c "import ctypes, sys; ctypes.CDLL(sys.argv[1])" "$1" 2>/dev/null
}
has_egl() { loads libEGL.so.1; }
has_osmesa() { loads libOSMesa.so.8 || loads libOSMesa.so; }
install() { sh "$(dirname "$0")/apt_install.sh" "$@"; }
install_egl() {   # install_egl OTHERWISE
    install EGL "$1" libegl1 libgl1 libgl1-mesa-dri
}

has_egl || has_osmesa \
    || install_egl "install your system's EGL or OSMesa library, then try again"
if [ "${1:-}" = both ]; then
    without="the test that compares EGL with OSMesa will be skipped"
    has_egl || install_egl "$without" || echo "Going on without EGL: $without."
    has_osmesa || install OSMesa "$without" libosmesa6 || echo "Going on without OSMesa: $without."
fi
