"""Rendered sequences by what decides their bytes, in a folder or in object storage."""

from __future__ import annotations

import hashlib
import json
import shutil
import tarfile
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from functools import lru_cache
from pathlib import Path

from simbench.certificate import motion_sha256, poses_of
from simbench.errors import UserError
from simbench.generate import GenerateSettings, generate, identity_of
from simbench.remote import file_system, is_url


class SequenceCache:
    """Sequences under the SHA-256 of their settings, library versions and renderer.

    A folder holds each as a folder, a URL (`s3://…`, `gs://…`, `memory://…`; needs fsspec) as
    a tar file. Either is there whole or not at all. Nothing is ever deleted.

    Args:
        place: a path or a URL.
    Raises:
        UserError: fsspec, or what it needs for this kind of URL, is not installed.
    """

    def __init__(self, place: str) -> None:
        self.place = place.rstrip("/") or "/"
        self._remote = is_url(place)
        if self._remote:
            file_system(place, "--cache")

    def check_writable(self) -> None:
        """Raises OSError where it is a folder in which nothing can be kept."""
        if not self._remote:
            Path(self.place).mkdir(parents=True, exist_ok=True)
            with tempfile.TemporaryFile(dir=self.place):
                pass

    @contextmanager
    def folder_of(self, settings: GenerateSettings) -> Iterator[Path]:
        """The sequence's folder, rendered now if the cache has none; only to be read.

        Raises:
            UserError: wrong settings, or the storage cannot be reached.
            OSError: the disk is full or the folder cannot be written.
        """
        key = key_of(settings)
        if self._remote:
            with tempfile.TemporaryDirectory(prefix="simbench-") as scratch:
                yield self._fetched(settings, key, Path(scratch))
            return
        folder = Path(self.place) / key
        if not folder.is_dir():
            folder.parent.mkdir(parents=True, exist_ok=True)
            with tempfile.TemporaryDirectory(prefix=f".{key[:12]}.", dir=folder.parent) as scratch:
                made = Path(scratch) / "sequence"
                generate(settings, made)
                try:
                    made.rename(folder)
                except OSError:      # another worker was first
                    if not folder.is_dir():
                        raise
        yield folder

    def _fetched(self, settings: GenerateSettings, key: str, scratch: Path) -> Path:
        files, root = file_system(self.place, "--cache")
        there, folder, packed = f"{root}/{key}.tar", scratch / key, scratch / "tar"
        try:
            if files.exists(there):
                files.get_file(there, str(packed))
                with tarfile.open(packed) as tar:
                    tar.extractall(folder, filter="data")
                return folder
            generate(settings, folder)
            with tarfile.open(packed, "w") as tar:
                tar.add(folder, arcname=".")
            files.makedirs(root, exist_ok=True)
            files.put_file(str(packed), f"{there}.{scratch.name}")
            files.mv(f"{there}.{scratch.name}", there)
        except tarfile.TarError as error:
            raise UserError(f"--cache {self.place}: {there} is damaged ({error}); delete it"
                            ) from None
        finally:
            packed.unlink(missing_ok=True)
        return folder


@lru_cache(maxsize=256)
def key_of(settings: GenerateSettings) -> str:
    """SHA-256 of all that decides a sequence's bytes, the scene's shapes and motion among it."""
    world = settings.make_world()
    identity = identity_of(settings, world) | {
        "motion_sha256": motion_sha256(*poses_of(world, settings.frames))}
    return hashlib.sha256(json.dumps(identity, sort_keys=True).encode()).hexdigest()


@contextmanager
def scratch_folder(settings: GenerateSettings) -> Iterator[Path]:
    """The sequence rendered for one use, where there is no cache."""
    scratch = Path(tempfile.mkdtemp(prefix="simbench-"))
    try:
        generate(settings, scratch / "sequence")
        yield scratch / "sequence"
    finally:
        shutil.rmtree(scratch, ignore_errors=True)
