"""What scripts/install_opengl.sh installs, with an apt-get and a linker of the test's own."""

from __future__ import annotations

import subprocess
from pathlib import Path

import pytest

from document_blocks import ROOT

EGL, OSMESA = "libegl1 libgl1 libgl1-mesa-dri", "libosmesa6"


def installed(folder: Path, there: str, *words: str, apt_fails: bool = False) -> tuple[int, str]:
    """The script's exit code and the packages it asked for, where `there` is what loads."""
    for name, text in (("python", f'case " {there} " in *" $3 "*) exit 0;; esac; exit 1'),
                       ("apt-get", f'[ "$2" = update ] || echo "$@" >> {folder}/asked; '
                                   f'exit {int(apt_fails)}'),
                       ("id", "echo 0")):
        (folder / name).write_text(f"#!/bin/sh\n{text}\n")
        (folder / name).chmod(0o755)
    done = subprocess.run(["sh", str(ROOT / "scripts/install_opengl.sh"), *words], check=False,
                          env={"PATH": f"{folder}:/usr/bin:/bin", "PYTHON": f"{folder}/python"},
                          capture_output=True, text=True)
    asked = folder / "asked"
    lines = asked.read_text().splitlines() if asked.exists() else []
    return done.returncode, " | ".join(x.partition("recommends ")[2] for x in lines)


@pytest.mark.parametrize(("there", "words", "packages"), [
    ("libEGL.so.1", (), ""),
    ("libOSMesa.so.8", (), ""),
    ("", (), EGL),
    ("libEGL.so.1 libOSMesa.so.8", ("both",), ""),
    ("libEGL.so.1", ("both",), OSMESA),
    ("libOSMesa.so", ("both",), EGL)])
def test_what_is_missing_is_installed(tmp_path, there, words, packages):
    assert installed(tmp_path, there, *words) == (0, packages)


def test_without_osmesa_the_tests_go_on_and_without_any_opengl_they_do_not(tmp_path):
    assert installed(tmp_path, "libEGL.so.1", "both", apt_fails=True)[0] == 0
    assert installed(tmp_path, "", "both", apt_fails=True)[0] != 0
