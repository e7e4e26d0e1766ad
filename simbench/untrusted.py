"""Files from strangers: regular ones only, none too large, and nothing in them is run."""

from __future__ import annotations

import json
import os
import stat
from pathlib import Path
from typing import Any

import yaml

from simbench.errors import BadFile, UserError

MOST_TEXT_BYTES = 64_000_000
MOST_SIDE_PX = 8192


def read_bytes(path: Path, most: int, error: type[UserError] = BadFile, kind: str = "file"
               ) -> bytes:
    """All bytes of a regular file.

    Args:
        most: bytes; a larger file is refused before it is read.
        error: what is raised.
        kind: what the file is, for the message.
    Raises:
        BadFile, or `error`: it is missing, too large, unreadable, or no regular file (a pipe or a
            device may never end).
    """
    try:
        # Not blocking: to open a pipe would otherwise wait for somebody to write.
        with os.fdopen(os.open(path, os.O_RDONLY | os.O_NONBLOCK), "rb") as file:
            about = os.fstat(file.fileno())
            if not stat.S_ISREG(about.st_mode):
                raise error(f"{path}: not a regular file; replace it")
            if about.st_size > most:
                raise error(f"{path}: {about.st_size} bytes, at most {most} can be right; "
                            "replace it")
            data = file.read(most + 1)      # devices of some systems say that they have 0 bytes
    except FileNotFoundError:
        raise error(f"{path}: no such {kind}; check the path or restore it") from None
    except (OSError, ValueError) as problem:
        reason = getattr(problem, "strerror", None) or problem
        raise error(f"{path}: cannot be read ({reason}); check the path") from None
    if len(data) > most:
        raise error(f"{path}: more than {most} bytes; replace it")
    return data


def read_text(path: Path, most: int = MOST_TEXT_BYTES) -> str:
    """The text of a file. Raises BadFile when it is missing, too large or not text."""
    try:
        return read_bytes(path, most).decode("utf-8").replace("\r\n", "\n")
    except UnicodeDecodeError:
        raise BadFile(f"{path}: not a text file; replace it") from None


def read_json_object(path: Path, otherwise: str, most: int = MOST_TEXT_BYTES) -> dict[str, Any]:
    """A JSON object. Raises BadFile, which ends in `otherwise`, when it is missing or none."""
    try:
        value = json.loads(read_bytes(path, most), parse_constant=_no_number)
    except (ValueError, RecursionError) as error:
        line = f":{error.lineno}" if isinstance(error, json.JSONDecodeError) else ""
        raise BadFile(f"{path}{line}: not valid JSON ({str(error)[:80]}); {otherwise}"
                      ) from None
    except BadFile as error:
        raise BadFile(f"{str(error).rpartition(';')[0]}; {otherwise}") from None
    if not isinstance(value, dict):
        raise BadFile(f"{path}: not a JSON object; {otherwise}")
    return value


def _no_number(word: str) -> float:
    raise ValueError(f"{word} is no number")


class _PlainLoader(yaml.SafeLoader):
    """YAML's safe loader without aliases, ten lines of which can stand for gigabytes, and without
    keys that stand there twice, of which the first would be lost in silence."""

    def compose_node(self, parent: Any, index: Any) -> Any:
        if self.check_event(yaml.AliasEvent):
            event = self.peek_event()
            raise yaml.composer.ComposerError(None, None, "aliases are not allowed",
                                              event.start_mark)
        return super().compose_node(parent, index)

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
        seen = set()
        for key, _ in node.value:
            if (key.tag, str(key.value)) in seen:
                raise yaml.constructor.ConstructorError(
                    None, None, f"key {key.value!r:.40} stands there twice", key.start_mark)
            seen.add((key.tag, str(key.value)))
        return super().construct_mapping(node, deep)


def read_yaml(path: Path, otherwise: str, most: int = 1_000_000) -> Any:
    """What a YAML file says. Raises BadFile, with the line, when it is missing or not YAML."""
    text = read_text(path, most)
    try:
        return yaml.load(text, Loader=_PlainLoader)
    except (yaml.YAMLError, ValueError, RecursionError, OverflowError) as error:
        mark = getattr(error, "problem_mark", None)
        line = "" if mark is None else f":{mark.line + 1}"
        reason = getattr(error, "problem", None) or str(error)
        raise BadFile(f"{path}{line}: not YAML ({' '.join(str(reason).split())[:80]}); "
                      f"{otherwise}") from None


def check_links(folder: Path) -> None:
    """No link in a folder leads out of it. Raises BadFile."""
    root = Path(os.path.realpath(folder))
    waiting = [str(folder)]
    while waiting:
        with os.scandir(waiting.pop()) as entries:
            for entry in entries:
                if entry.is_symlink():
                    if not Path(os.path.realpath(entry.path)).is_relative_to(root):
                        raise BadFile(f"{entry.path}: a link that leads out of {folder}; put the "
                                      "file itself there")
                elif entry.is_dir(follow_symlinks=False):
                    waiting.append(entry.path)
