"""`simbench list`: what there is, one line each, or one of them."""

from __future__ import annotations

import difflib
import shutil
import sys
import textwrap
from collections.abc import Mapping
from typing import TYPE_CHECKING, Annotated

import typer

from simbench.errors import UnknownName

if TYPE_CHECKING:
    from simbench.scene import SceneSpec

_NARROWEST = 40     # characters; below, lines break where they will
_NAME_WIDTH = 26    # characters of the first column


def list_command(
        name: Annotated[str | None, typer.Argument(
            metavar="[NAME]", help="One of them alone; of a suite the whole file, to write one of "
                                   "your own from.")] = None) -> None:
    """Scenes with their dials, systems, suites, tables and sensors."""
    from simbench.suites.files import list_suites, suite_text

    if name in list_suites():
        typer.echo(suite_text(name), nl=False)
        return
    known = _sections()
    if name is None:
        typer.echo("\n\n".join(f"{heading}\n" + "\n".join(entries.values())
                               for heading, entries in known.items()))
        return
    found = {each: entry for entries in known.values() for each, entry in entries.items()}
    if name not in found:
        close = difflib.get_close_matches(name, found, n=1, cutoff=0.5)
        hint = f"; did you mean {close[0]!r}?" if close else ";"
        raise UnknownName(f"nothing is named {name!r}{hint} `simbench list` shows all that there "
                          "is")
    typer.echo(found[name])


def _sections() -> dict[str, dict[str, str]]:
    """Heading → name → its lines."""
    from simbench.reproduce.table import list_tables, load_table
    from simbench.scene import list_scenes
    from simbench.sensors.spec import SENSORS
    from simbench.suites.files import list_suites, load_suite
    from slam.systems.registry import descriptions

    def entries(texts: Mapping[str, str]) -> dict[str, str]:
        return {name: _entry(f"  {name}".ljust(_NAME_WIDTH), text)
                for name, text in texts.items()}

    return {
        "Scenes": {scene.name: _scene(scene) for scene in list_scenes()},
        "Systems": entries(descriptions()),
        "Suites": entries({name: " ".join(load_suite(name).description.split())
                           for name in list_suites()}),
        "Tables, for `simbench reproduce`": entries({name: load_table(name).title
                                                     for name in list_tables()}),
        "Sensors": entries({sensor.name: sensor.help for sensor in SENSORS.values()})}


def _scene(scene: SceneSpec) -> str:
    head = _entry(f"  {scene.name}".ljust(_NAME_WIDTH), f"{scene.description} "
                  f"({scene.width}x{scene.height}, {scene.fps:g} fps)")
    return "\n".join((head, *(
        _entry(f"      --dial {dial.name}={dial.shown(dial.default)}".ljust(_NAME_WIDTH + 10),
               f"{dial.allowed}: {dial.help}") for dial in scene.dials)))


def _entry(head: str, text: str) -> str:
    """One line into a pipe, so that grep finds it whole; in a terminal broken to its width."""
    width = shutil.get_terminal_size().columns
    if not sys.stdout.isatty() or width < _NARROWEST:
        return head + text
    indent = " " * min(len(head), width // 3)
    return textwrap.fill(head + text, width, subsequent_indent=indent, break_long_words=False,
                         break_on_hyphens=False)
