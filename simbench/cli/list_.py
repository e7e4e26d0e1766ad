"""`simbench list`: what there is, one line each."""

from __future__ import annotations

import typer


def list_command() -> None:
    """Scenes with their dials, systems, suites, tables and sensors."""
    from simbench.reproduce.table import list_tables, load_table
    from simbench.scene import list_scenes
    from simbench.sensors.spec import SENSORS
    from simbench.suites.files import list_suites, load_suite
    from slam.systems.registry import descriptions

    typer.echo("Scenes")
    for scene in list_scenes():
        typer.echo(f"  {scene.name:<20} {scene.description} "
                   f"({scene.width}x{scene.height}, {scene.fps:g} fps)")
        for dial in scene.dials:
            typer.echo(f"      --dial {dial.name}={dial.shown(dial.default)}".ljust(34)
                       + f"{dial.allowed}: {dial.help}")
    typer.echo("\nSystems")
    for name, text in descriptions().items():
        typer.echo(f"  {name:<20} {text}")
    typer.echo("\nSuites")
    for name in list_suites():
        typer.echo(f"  {name:<20} {' '.join(load_suite(name).description.split())}")
    typer.echo("\nTables, for `simbench reproduce`")
    for name in list_tables():
        typer.echo(f"  {name:<20} {load_table(name).title}")
    typer.echo("\nSensors")
    for sensor in SENSORS.values():
        typer.echo(f"  {sensor.name:<20} {sensor.help}")
