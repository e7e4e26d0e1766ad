#!/usr/bin/env bash
# Build the wheel, look into it, and list its scenes from a directory that is not the source tree.
# usage: check_wheel.sh PYTHON   (a Python in which the project's dependencies are installed)
set -euo pipefail
python=$(realpath --no-symlinks "$1")
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT

"$python" -m pip wheel --quiet --disable-pip-version-check --no-deps --wheel-dir "$work" .
wheel=$(ls "$work"/simbench_slam-*.whl)
"$python" -m zipfile --list "$wheel" >"$work/contents"
for scene in scenes/*.xml; do
    grep -q "simbench/_$scene " "$work/contents" || { echo "$wheel lacks $scene" >&2; exit 1; }
done

# The wheel alone in front of the installed dependencies: the source tree is not on the path.
"$python" -m pip install --quiet --disable-pip-version-check --no-deps --target "$work/site" "$wheel"
mkdir "$work/empty"
cd "$work/empty"
PYTHONPATH="$work/site" "$python" - "$work/site" <<'END'
import sys
import simbench, simbench.cli
assert simbench.__file__.startswith(sys.argv[1]), simbench.__file__
sys.argv = ["simbench", "list"]
simbench.cli.main()
END
echo "wheel: $(basename "$wheel") holds its scenes and lists them"
