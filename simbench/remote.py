"""Sequences in object storage, by fsspec: `s3://…`, `gs://…`, `memory://…`, `file://…`.

A URL is fetched into a cache on this machine, under the hash of what it holds, and read from there.
The cache is $SIMBENCH_CACHE, else ~/.cache/simbench; it may be deleted at any time.
"""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path, PurePosixPath
from typing import Any

from simbench.errors import BadFile, UserError
from simbench.extras import how_to_install
from simbench.storage import MANIFEST, file_sha256

_MOST_FILES = 1_000_000
_MOST_MANIFEST_BYTES = 200_000_000


def is_url(place: str | Path) -> bool:
    """Whether a place is a URL rather than a path."""
    return "://" in str(place)


def local_folder(place: str | Path) -> Path:
    """The folder itself, or where the bytes of a URL lie on this machine, fetched if need be.

    Raises:
        UserError: fsspec, or what it needs for this kind of URL, is not installed.
        BadFile: nothing is there, it cannot be read, or a file is not what its manifest says.
    """
    return _fetched(str(place)) if is_url(place) else Path(place)


def file_system(url: str, option: str = "") -> tuple[Any, str]:
    """fsspec's file system of a URL, and the path in it.

    Args:
        option: how the URL was given, for the error.
    Raises:
        UserError: fsspec, or what it needs for this kind of URL, is not installed.
    """
    where = f"{option} {url}".strip()
    try:
        import fsspec  # noqa: PLC0415 (an extra)
    except ModuleNotFoundError:
        raise UserError(f"{where}: object storage needs fsspec; "
                        f"{how_to_install('storage')}") from None
    try:
        files, root = fsspec.core.url_to_fs(url)
    except ImportError as error:
        raise UserError(f"{where}: {error}") from None
    except ValueError as error:
        raise UserError(f"{where}: {error}; wanted a URL that fsspec knows, as s3://bucket/boxes"
                        ) from None
    return files, str(root).rstrip("/")


def check_free(url: str) -> None:
    """Raises UserError where something is stored already, or the storage cannot be reached."""
    files, root = file_system(url)
    with _spoken(url):
        if files.exists(root) and files.find(root):
            raise UserError(f"{url}: something is there already; choose another place")


def store(folder: Path, url: str) -> None:
    """Copy a sequence's folder to a URL, its manifest last: with it the sequence is whole.

    Raises:
        UserError: fsspec is not installed, or something is there already.
        BadFile: the storage cannot be written.
    """
    check_free(url)
    files, root = file_system(url)
    names = sorted(path.relative_to(folder).as_posix() for path in folder.rglob("*")
                   if path.is_file())
    names.sort(key=lambda name: name == MANIFEST)
    with _spoken(url):
        for name in names:
            target = f"{root}/{name}"
            files.makedirs(target.rpartition("/")[0], exist_ok=True)
            files.put_file(str(folder / name), target)


def _fetched(url: str) -> Path:
    files, root = file_system(url)
    with _spoken(url):
        manifest = _manifest(files, root, url)
        if manifest is None:
            wanted, key = _listed(files, root, url)
        else:
            wanted, key = manifest
        home = _cache() / key
        if home.is_dir():
            return home
        home.parent.mkdir(parents=True, exist_ok=True)
        scratch = Path(tempfile.mkdtemp(prefix=f".{key[:12]}.", dir=home.parent))
        try:
            for name, sha256 in wanted.items():
                target = scratch / "sequence" / name
                target.parent.mkdir(parents=True, exist_ok=True)
                files.get_file(f"{root}/{name}", str(target))
                if sha256 and file_sha256(target) != sha256:
                    raise BadFile(f"{url}/{name}: not the file that {MANIFEST} names; store the "
                                  "sequence again")
            try:
                (scratch / "sequence").rename(home)
            except OSError:         # another process was first
                if not home.is_dir():
                    raise
        finally:
            shutil.rmtree(scratch, ignore_errors=True)
    return home


def _manifest(files: Any, root: str, url: str) -> tuple[dict[str, str], str] | None:
    """Files and hashes that a manifest names, and its own SHA-256; None where there is none."""
    place = f"{root}/{MANIFEST}"
    if not files.exists(place):
        return None
    if files.size(place) > _MOST_MANIFEST_BYTES:
        raise BadFile(f"{url}/{MANIFEST}: larger than 200 MB; this is no sequence")
    data = files.cat_file(place)
    key = hashlib.sha256(data).hexdigest()
    try:
        named: Mapping[str, str] = json.loads(data)["files"]
        wanted = {_inside(str(name), url): str(sha256) for name, sha256 in named.items()}
    except (ValueError, TypeError, KeyError, AttributeError, RecursionError):
        raise BadFile(f"{url}/{MANIFEST}: not a manifest; store the sequence again") from None
    return wanted | {MANIFEST: key}, key


def _listed(files: Any, root: str, url: str) -> tuple[dict[str, str], str]:
    """The files below a URL, and a hash of their names, sizes and times."""
    found = files.find(root, detail=True)
    if not found:
        raise BadFile(f"{url}: nothing is there; give the URL of a sequence")
    if len(found) > _MOST_FILES:
        raise BadFile(f"{url}: {len(found)} files; at most {_MOST_FILES} make a sequence")
    size = sum(int(about.get("size") or 0) for about in found.values())
    home = _cache()
    home.mkdir(parents=True, exist_ok=True)
    if size > shutil.disk_usage(home).free:
        raise BadFile(f"{url}: {size / 1e9:.1f} GB do not fit in {home}; free some space or set "
                      "SIMBENCH_CACHE")
    digest = hashlib.sha256(url.encode())
    wanted = {}
    for path in sorted(found):
        name = _inside(path.removeprefix(root).lstrip("/"), url)
        wanted[name] = ""
        about = found[path]
        state = [str(about.get(key)) for key in ("size", "ETag", "etag", "mtime", "created",
                                                 "last_modified", "LastModified")]
        digest.update("\0".join([name, *state]).encode())
    return wanted, digest.hexdigest()


def _inside(name: str, url: str) -> str:
    """The name, if it stays inside its folder. Raises BadFile."""
    path = PurePosixPath(name)
    if not name or path.is_absolute() or ".." in path.parts or "\\" in name or "\0" in name:
        raise BadFile(f"{url}: holds a file named {name!r}, which leads out of its folder")
    return name


def _cache() -> Path:
    chosen = os.environ.get("SIMBENCH_CACHE")
    return Path(chosen) if chosen else Path(
        os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "simbench"


@contextmanager
def _spoken(url: str) -> Iterator[None]:
    """Whatever a storage library raises, as one line."""
    try:
        yield
    except UserError:
        raise
    except Exception as error:
        said = str(error) or "no reason given"
        raise BadFile(f"{url}: the storage failed ({type(error).__name__}: {said})") from error
