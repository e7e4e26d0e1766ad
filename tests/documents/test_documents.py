"""Every code block of the documents does what it says.

A page is followed from top to bottom in an empty folder: files are written, Python is run, commands
are run on a few small frames. A command whose comment says that it `needs` something or `takes`
long is held against the real command line instead, and so are all of the pages of measurements.
"""

from __future__ import annotations

import ast
import importlib
import json
import sys
import xml.etree.ElementTree
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
import yaml

from command_lines import check_command
from document_blocks import ROOT, Block, Command, blocks, commands
from here import Here
from simbench import scene
from simbench.cli import main
from simbench.suites import run_suite
from simbench.suites.files import load_suite
from simbench.suites.pool import Workers

PAGES = sorted(str(path.relative_to(ROOT)) for path in
               [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *(ROOT / "docs").rglob("*.md"),
                *(ROOT / "examples").rglob("*.md")])
MEASUREMENTS = {"docs/results.md", "docs/departures.md"}   # minutes to hours each, and said there
FEW_FRAMES, SMALL = "2", "128x96"


def on_a_budget(words: tuple[str, ...]) -> list[str]:
    """The same command on few small frames."""
    out = list(words)
    if "--frames" in out:
        at = out.index("--frames") + 1
        out[at] = min(out[at], FEW_FRAMES, key=int)
    is_scene = out[2].rpartition(":")[2] in {each.name for each in scene.list_scenes()}
    if out[1] in ("run", "generate") and is_scene and "--size" not in out:
        out += ["--size", SMALL]
    if out[1] in ("run", "generate") and "--frames" not in out:
        out += ["--frames", FEW_FRAMES]
    if out[1] == "suite":
        out += ["--frames", "2", "--size", "64x48", "--reports", "none"]
        out += [] if "--seeds" in out else ["--seeds", "0"]
    return out


def is_run(page: str, command: Command) -> bool:
    return command.words[0] == "simbench" and not command.is_for_the_reader \
        and page not in MEASUREMENTS


@contextmanager
def modules_of(folder: Path) -> Iterator[None]:
    """Modules that a page imports from its folder, and their scenes, are forgotten afterwards."""
    builtin = {each.name for each in scene.list_scenes()}
    before = set(sys.modules)
    sys.path.insert(0, str(folder))
    importlib.invalidate_caches()
    try:
        yield
    finally:
        sys.path.remove(str(folder))
        for name in set(sys.modules) - before:
            if str(getattr(sys.modules[name], "__file__", "")).startswith(str(folder)):
                del sys.modules[name]
        for name in set(scene._SCENES) - builtin:
            del scene._SCENES[name]


@pytest.fixture
def suites_in_this_process(monkeypatch):
    @contextmanager
    def workers(count):
        yield Workers(Here(), 1)

    monkeypatch.setattr(run_suite, "local_workers", workers)


@pytest.mark.parametrize("page", PAGES)
def test_a_page_does_what_it_says(page, tmp_path, monkeypatch, suites_in_this_process, capsys):
    monkeypatch.chdir(tmp_path)
    names: dict[str, object] = {"__name__": "__main__"}
    with modules_of(tmp_path):
        for block in blocks(page):
            follow(block, names)
            capsys.readouterr()


def follow(block: Block, names: dict[str, object]) -> None:
    """Do what a block says, in the present folder."""
    if block.title and (ROOT / block.title).is_file():
        check_excerpt(block)
        return
    if block.title:
        Path(block.title).parent.mkdir(parents=True, exist_ok=True)
        Path(block.title).write_text(block.text)
    _DO[block.language](block, names)


def follow_python(block: Block, names: dict[str, object]) -> None:
    """Run it, unless it is a file that the page runs later: then see that it is Python."""
    if block.title and not Path(block.title).name.startswith("test_"):
        ast.parse(block.text, block.place)
    else:
        exec(compile(block.text, block.place, "exec"), names)


def follow_shell(block: Block, _: dict[str, object]) -> None:
    for command in commands(block):
        if is_run(block.page, command):
            words = on_a_budget(command.words)
            with modules_of(Path.cwd()):      # a process of its own knows no scene of the page
                assert main(words[1:]) == 0, f"{command.place}: {' '.join(words)}"
        else:
            check_command(command.words)


def follow_yaml(block: Block, _: dict[str, object]) -> None:
    """A suite, cut short, loses no frame; a GitHub workflow is held against the command lines."""
    content = yaml.safe_load(block.text)
    if "cases" in content:
        Path("block.yaml").write_text(block.text)
        assert load_suite("block.yaml").name == content["name"]
        assert main(["suite", "block.yaml", "--seeds", "0", "--frames", "3",
                     "--out", "block"]) == 0
        runs = json.loads(Path("block/results.json").read_text())["runs"]
        assert runs
        assert not any(run["lost_frames"] for run in runs)
    for job in content.get("jobs", {}).values():
        for step in job["steps"]:
            for line in step.get("run", "").splitlines():
                for words in line.split("&&"):
                    check_command(tuple(words.split()))


def follow_xml(block: Block, _: dict[str, object]) -> None:
    xml.etree.ElementTree.fromstring(block.text)


def nothing_to_do(block: Block, _: dict[str, object]) -> None:
    """Output, drawings and references."""


_DO = {"python": follow_python, "sh": follow_shell, "yaml": follow_yaml, "xml": follow_xml,
       "text": nothing_to_do, "bibtex": nothing_to_do}


def check_excerpt(block: Block) -> None:
    """The classes and members that a page shows of one of our modules are there."""
    real = {node.name: members(node) for node in ast.parse((ROOT / block.title).read_text()).body
            if isinstance(node, ast.ClassDef)}
    for node in ast.parse(block.text, block.place).body:
        if isinstance(node, ast.ClassDef):
            missing = members(node) - real[node.name]
            assert not missing, f"{block.place}: {node.name} has no {sorted(missing)}"


def members(node: ast.ClassDef) -> set[str]:
    """Methods, annotated fields, and what is assigned to `self`."""
    out = {each.name for each in node.body if isinstance(each, ast.FunctionDef)}
    out |= {each.target.id for each in node.body
            if isinstance(each, ast.AnnAssign) and isinstance(each.target, ast.Name)}
    return out | {each.attr for each in ast.walk(node) if isinstance(each, ast.Attribute)
                  and isinstance(each.value, ast.Name) and each.value.id == "self"}


def test_every_block_says_what_it_is():
    """None escapes for want of a language; `text` is what nobody can run."""
    odd = [block.place for page in PAGES for block in blocks(page) if block.language not in _DO]
    assert not odd, f"code blocks without a language, or with an unknown one: {odd}"


def test_most_commands_are_run_and_the_rest_are_marked():
    """The pages of measurements aside, what is only held against the command line is counted."""
    told = [command for page in PAGES if page not in MEASUREMENTS for block in blocks(page)
            if block.language == "sh" for command in commands(block)
            if command.words[0] == "simbench"]
    run = [command for command in told if not command.is_for_the_reader]
    print(f"{len(run)} of {len(told)} simbench commands are run")
    assert len(run) >= 0.6 * len(told)
