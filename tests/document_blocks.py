"""The code blocks of Markdown pages: what each is, where it stands, and what it says."""

from __future__ import annotations

import re
import shlex
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
_FENCE = re.compile(r"^(?P<fence>```+)(?P<language>\w*)(?:\s+title=\"(?P<title>[^\"]+)\")?\s*$")
_INDENT = "    "
# A comment that tells readers and tests alike that a command needs more than the page gives.
_LEFT_TO_THE_READER = re.compile(r"\s#\s.*\b(needs|takes)\b")


@dataclass(frozen=True, slots=True)
class Block:
    """One code block."""

    page: str        # relative to the project's root
    line: int        # of its first line of code, from 1
    language: str    # "" where a fence names none
    title: str       # the file that it is; "" where it is none
    text: str

    @property
    def place(self) -> str:
        return f"{self.page}:{self.line}"


@dataclass(frozen=True, slots=True)
class Command:
    """One command of a shell block."""

    place: str
    words: tuple[str, ...]
    is_for_the_reader: bool    # marked as one that needs what is not here, or takes too long


def blocks(page: str) -> list[Block]:
    """All fenced blocks of a page, and the indented ones, which are shell commands."""
    lines = (ROOT / page).read_text().splitlines()
    out, i = [], 0
    while i < len(lines):
        opened = _FENCE.match(lines[i])
        if opened:
            end = lines.index(opened["fence"], i + 1)
            out.append(Block(page, i + 2, opened["language"], opened["title"] or "",
                             "\n".join(lines[i + 1:end]) + "\n"))
            i = end
        elif lines[i].startswith(_INDENT) and i > 0 and not lines[i - 1].strip() \
                and not _continues_a_list(lines[:i]):
            end = next((k for k in range(i, len(lines)) if not lines[k].startswith(_INDENT)),
                       len(lines))
            out.append(Block(page, i + 1, "sh", "",
                             "\n".join(line.strip() for line in lines[i:end]) + "\n"))
            i = end - 1
        i += 1
    return out


def _continues_a_list(before: list[str]) -> bool:
    text = next((line for line in reversed(before) if line.strip()), "")
    return bool(re.match(r"\s*([*+-]|\d+\.)\s", text)) or text.startswith("  ")


def commands(block: Block) -> list[Command]:
    """The commands of a shell block; a backslash at the end of a line carries it on."""
    out = []
    lines = block.text.replace("\\\n", "  ").splitlines()
    for number, line in enumerate(lines):
        words = tuple(shlex.split(line, comments=True))
        if words:
            out.append(Command(f"{block.page}:{block.line + number}", words,
                               bool(_LEFT_TO_THE_READER.search(line))))
    return out
