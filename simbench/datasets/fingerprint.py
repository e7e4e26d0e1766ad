"""What identifies a recording: its text files by content, its images by name and size."""

from __future__ import annotations

import hashlib
from pathlib import Path

_BY_CONTENT = {".txt", ".yaml", ".json"}


def folder_fingerprint(folder: Path, intrinsics: object) -> str:
    """SHA-256 over the calibration, the top-level text files and every other file's size."""
    digest = hashlib.sha256(repr(intrinsics).encode())
    for path in sorted(p for p in folder.rglob("*") if p.is_file()):
        name = path.relative_to(folder).as_posix()
        digest.update(f"\0{name}\0{path.stat().st_size}\0".encode())
        if path.parent == folder and path.suffix in _BY_CONTENT:
            digest.update(path.read_bytes())
    return digest.hexdigest()
