"""Errors that are the user's to mend: one line that says what, where and what to do."""

from __future__ import annotations

_MOST_CHARACTERS = 1500
_END_CHARACTERS = 400       # what to do stands at the end


def one_line(message: str) -> str:
    """A message fit for a terminal: one line, not too long, nothing that would steer the terminal.

    What a stranger's file says may be part of it, so it may hold anything.
    """
    words = " ".join(message.split())
    shown = "".join(c if c.isprintable() else ascii(c)[1:-1] for c in words)
    if len(shown) <= _MOST_CHARACTERS:
        return shown
    return f"{shown[:_MOST_CHARACTERS - _END_CHARACTERS - 3]} … {shown[-_END_CHARACTERS:]}"


class UserError(Exception):
    """Wrong input. The command line prints the message on one line and exits with 2."""

    def __init__(self, message: str) -> None:
        super().__init__(one_line(message))


class UnknownName(UserError):
    """A scene, system, sensor, suite, dial or setting that does not exist."""


class BadFile(UserError):
    """A file that is missing, truncated, of the wrong size or unreadable; the path is named."""


class BadFrame(UserError):
    """One frame of a sequence cannot be read: the run marks it lost and goes on."""
