"""Commands as the documents print them, held against the programs that they call."""

from __future__ import annotations

import ast
import re
import tomllib
from collections.abc import Callable, Mapping
from functools import cache
from pathlib import Path

import typer

from document_blocks import ROOT
from simbench.cli import app
from simbench_pytest import pytest_addoption


def check_command(words: tuple[str, ...]) -> None:
    """Raises AssertionError or a usage error where no such program, target or option exists."""
    if words[0] == "for":      # for NAME in …; do COMMAND; done
        words = words[words.index("do") + 1:words.index("done")]
        words = (*words[:-1], words[-1].rstrip(";"))
    while words[0] in ("time", "sudo", "nice") or re.fullmatch(r"[A-Z_]+=\S*", words[0]):
        words = words[1:]
    program = Path(words[0]).name
    assert program in _CHECKS, f"{words[0]}: the tests know no such program; mark or teach it"
    _CHECKS[program](words[1:])


@cache
def _simbench() -> typer.core.TyperGroup:
    return typer.main.get_command(app)


def _check_simbench(words: tuple[str, ...]) -> None:
    assert words, "simbench: no command"
    if words[0].startswith("-"):
        return
    command = _simbench().commands.get(words[0])
    assert command is not None, f"simbench has no command {words[0]}"
    if "--help" not in words:
        command.make_context(words[0], list(words[1:]))


def _check_make(words: tuple[str, ...]) -> None:
    targets = re.findall(r"^(\w+):", (ROOT / "Makefile").read_text(), flags=re.MULTILINE)
    assert set(words) <= set(targets)


def _check_python(words: tuple[str, ...]) -> None:
    if words[0] == "-m":
        return
    source = (ROOT / words[0]).read_text()
    known = {node.value for node in ast.walk(ast.parse(source))
             if isinstance(node, ast.Constant) and isinstance(node.value, str)}
    unknown = [word for word in words[1:] if word.startswith("--") and word not in known]
    assert not unknown, f"{words[0]} has no {unknown}"


def _check_pip(words: tuple[str, ...]) -> None:
    extras = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"][
        "optional-dependencies"]
    for names in re.findall(r"\.\[([\w,]+)\]", " ".join(words)):
        assert set(names.split(",")) <= set(extras)


def _check_pytest(words: tuple[str, ...]) -> None:
    ours: list[str] = []

    class Group:
        def getgroup(self, name: str) -> Group:
            return self

        def addoption(self, name: str, **_: object) -> None:
            ours.append(name)

    pytest_addoption(Group())
    unknown = [w for w in words if w.startswith("--simbench") and w.split("=")[0] not in ours]
    assert not unknown, f"the plugin has no {unknown}"


def _installs(words: tuple[str, ...]) -> None:
    assert words[0] in ("update", "install")


_CHECKS: Mapping[str, Callable[[tuple[str, ...]], None]] = {
    "simbench": _check_simbench, "make": _check_make, "python": _check_python,
    "pip": _check_pip, "pytest": _check_pytest, "apt-get": _installs}
