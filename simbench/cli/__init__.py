"""The command line: one module for each command; `main` turns errors into one line.

A command module imports what is heavy (MuJoCo, OpenCV, zarr) inside its function, so that
`simbench --help` answers at once.
"""

from __future__ import annotations

import errno
import logging
import sys
import traceback
from collections.abc import Sequence
from importlib import metadata
from typing import Annotated

import typer

from simbench.cli import (
    export,
    gate,
    generate,
    list_,
    reproduce,
    run,
    score,
    suite,
    verify,
    view,
)
from simbench.errors import UserError, one_line

app = typer.Typer(add_completion=False, rich_markup_mode=None,
                  help="A benchmark for dynamic SLAM with exact simulated truth.")
app.command("list")(list_.list_command)
app.command("generate")(generate.generate_command)
app.command("run")(run.run_command)
app.command("score")(score.score_command)
app.command("suite")(suite.suite_command)
app.command("reproduce")(reproduce.reproduce_command)
app.command("bless")(gate.bless_command)
app.command("gate")(gate.gate_command)
app.command("verify")(verify.verify_command)
app.command("export")(export.export_command)
app.command("view")(view.view_command)

# typer carries click inside in some versions and imports it in others.
_UsageProblem: type[Exception] = next(
    c for c in typer.BadParameter.__mro__ if c.__name__ == "ClickException")
_DEBUG = "--debug"
_INTERRUPTED = 130


def _show_version(asked: bool) -> None:
    if asked:
        typer.echo(f"simbench {metadata.version('simbench-slam')}")
        raise typer.Exit


@app.callback()
def _common(
        debug: Annotated[bool, typer.Option(
            _DEBUG, help="Show the traceback of an error; may stand anywhere.")] = False,
        version: Annotated[bool, typer.Option(
            "--version", callback=_show_version, is_eager=True,
            help="Show the version.")] = False) -> None:
    """A benchmark for dynamic SLAM with exact simulated truth."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command and return its exit code: 0 done, 1 gate failed, 2 the input is wrong."""
    words = list(sys.argv[1:] if arguments is None else arguments)
    debug = _DEBUG in words
    logging.basicConfig(level=logging.WARNING, format="%(levelname)s: %(message)s")
    try:
        if "" in words:
            raise UserError("an argument is empty, as a shell's variable without a value is in "
                            "quotes; give it or leave its option out")
        code = typer.main.get_command(app).main(
            [word for word in words if word != _DEBUG] or ["--help"], prog_name="simbench",
            standalone_mode=False)
    except UserError as error:
        return _failed(str(error), debug)
    except _UsageProblem as error:
        return _failed(_usage_message(error), debug)
    except BrokenPipeError:
        sys.stderr.close()   # the reader of our output has gone: nobody to tell
        return 1
    except OSError as error:
        return _failed(_os_message(error), debug)
    except (KeyboardInterrupt, typer.Abort):
        code = _INTERRUPTED
    if code == _INTERRUPTED:   # which typer makes of Ctrl-C by itself
        print("interrupted", file=sys.stderr)
    return code if isinstance(code, int) else 0


def _failed(message: str, debug: bool) -> int:
    if debug:
        traceback.print_exc()
    print("error: " + one_line(message), file=sys.stderr)
    return 2


def _usage_message(error: BaseException) -> str:
    context = getattr(error, "ctx", None)
    command = "simbench" if context is None else context.command_path
    message: str = error.format_message()  # type: ignore[attr-defined]
    return f"{message.rstrip('.?')}; see `{command} --help`"


def _os_message(error: OSError) -> str:
    where = error.filename if error.filename is not None else "writing"
    if error.errno in (errno.ENOSPC, errno.EDQUOT):
        return f"{where}: the disk is full; free some space or choose another --out"
    if error.errno in (errno.EACCES, errno.EPERM, errno.EROFS):
        return f"{where}: permission denied or read-only; choose another folder or mend its rights"
    if error.errno in (errno.EEXIST, errno.ENOTDIR):
        return f"{where}: a file stands where a folder is wanted; choose another path"
    return f"{where}: {error.strerror or error}; check the path"
