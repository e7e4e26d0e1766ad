"""Errors that are the user's to mend: one line that says what, where and what to do."""

from __future__ import annotations


class UserError(Exception):
    """Wrong input. The command line prints the message on one line and exits with 2."""


class UnknownName(UserError):
    """A scene, system, sensor, suite, dial or setting that does not exist."""


class BadFile(UserError):
    """A file that is missing, truncated, of the wrong size or unreadable; the path is named."""


class BadFrame(UserError):
    """One frame of a sequence cannot be read: the run marks it lost and goes on."""
