"""A page in headless Chromium: what goes wrong in it, and whether it fits a phone."""

from __future__ import annotations

import html
import json
import re
import shutil
import subprocess
from dataclasses import dataclass
from pathlib import Path

import pytest

# Before anything of the page: a picture that does not load and a script that fails are errors.
_WATCH = """<script>window.faults = [];
addEventListener("error", e => faults.push(e.message || "not loaded: " + e.target.src), true);
addEventListener("unhandledrejection", e => faults.push(String(e.reason)));</script>"""
_TELL = """<title></title><iframe id=f src="%s" width="%d" height="800"></iframe><pre id=o></pre>
<script>f.onload = () => {
  const d = f.contentDocument, w = f.contentWindow, images = [...d.images];
  o.textContent = "answer:" + JSON.stringify({
    faults: w.faults, images: images.length, width: d.documentElement.scrollWidth,
    empty: images.filter(i => !i.complete || !i.naturalWidth).length,
    small: [...d.querySelectorAll("p, td, th, li")].filter(e => e.textContent.trim() &&
           parseFloat(w.getComputedStyle(e).fontSize) < 11).length})}</script>"""


@dataclass(frozen=True)
class Seen:
    """What a browser says of a page."""

    faults: list[str]       # script errors, things that did not load
    images: int
    empty: int              # images without pixels
    width: int              # px that the page takes
    small: int              # texts below 11 px


def opened(page: Path, width: int) -> Seen:
    """Open a page in a frame of that width; the test is skipped where there is no Chromium."""
    chromium = shutil.which("chromium") or shutil.which("google-chrome")
    if chromium is None:
        pytest.skip("no chromium on this machine: sh scripts/install_chromium.sh installs it")
    text = page.read_text()
    watched = page.with_name(f"watched-{page.name}")
    watched.write_text(text.replace("<head>", "<head>" + _WATCH, 1) if "<head>" in text
                       else _WATCH + text)
    frame = page.with_name("frame.html")     # headless windows are never narrower than 500 px
    frame.write_text(_TELL % (watched.name, width))
    out = subprocess.run(
        [chromium, "--headless", "--no-sandbox", "--disable-gpu", "--window-size=1300,900",
         f"--user-data-dir={page.parent}/profile", "--allow-file-access-from-files",
         "--virtual-time-budget=3000", "--dump-dom", str(frame)],
        capture_output=True, text=True, timeout=120, check=False)
    found = re.search(r"answer:(\{.*\})", html.unescape(out.stdout))
    assert found, out.stderr[-500:]
    return Seen(**json.loads(found[1]))
