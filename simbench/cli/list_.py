"""`simbench list`: what there is, one line each."""

from __future__ import annotations

import shutil
import sys
import textwrap

import typer

_NARROWEST = 40     # characters; below, lines break where they will
_NAME_WIDTH = 26    # characters of the first column


def list_command() -> None:
    """Scenes with their dials, systems, suites, tables and sensors."""
    from simbench.reproduce.table import list_tables, load_table
    from simbench.scene import list_scenes
    from simbench.sensors.spec import SENSORS
    from simbench.suites.files import list_suites, load_suite
    from slam.systems.registry import descriptions

    typer.echo("Scenes")
    for scene in list_scenes():
        _entry(_name(scene.name), f"{scene.description} "
               f"({scene.width}x{scene.height}, {scene.fps:g} fps)")
        for dial in scene.dials:
            _entry(f"      --dial {dial.name}={dial.shown(dial.default)}".ljust(_NAME_WIDTH + 10),
                   f"{dial.allowed}: {dial.help}")
    typer.echo("\nSystems")
    for name, text in descriptions().items():
        _entry(_name(name), text)
    typer.echo("\nSuites")
    for name in list_suites():
        _entry(_name(name), ' '.join(load_suite(name).description.split()))
    typer.echo("\nTables, for `simbench reproduce`")
    for name in list_tables():
        _entry(_name(name), load_table(name).title)
    typer.echo("\nSensors")
    for sensor in SENSORS.values():
        _entry(_name(sensor.name), sensor.help)


def _name(text: str) -> str:
    return f"  {text}".ljust(_NAME_WIDTH)


def _entry(head: str, text: str) -> None:
    """One line into a pipe, so that grep finds it whole; in a terminal broken to its width."""
    width = shutil.get_terminal_size().columns
    if sys.stdout.isatty() and width >= _NARROWEST:
        indent = " " * min(len(head), width // 3)
        typer.echo(textwrap.fill(head + text, width, subsequent_indent=indent,
                                 break_long_words=False, break_on_hyphens=False))
    else:
        typer.echo(head + text)
