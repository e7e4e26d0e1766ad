"""Who follows docs/add-a-scene.md and docs/add-a-system.md has both in under 60 lines."""

from __future__ import annotations

import json
import subprocess
import sys

from document_blocks import ROOT, blocks, commands

SCENE, SYSTEM = "docs/add-a-scene.md", "docs/add-a-system.md"
WANTED_LINES = 60


def test_the_documents_code_runs_as_it_is_printed(tmp_path):
    files = [block for page in (SCENE, SYSTEM) for block in blocks(page) if block.title]
    assert [block.title for block in files] == ["conveyor.xml", "conveyor.py", "flow_odometry.py"]
    assert sum(len(block.text.splitlines()) for block in files) < WANTED_LINES
    for block in files:
        (tmp_path / block.title).write_text(block.text)
    both = next(command for block in blocks(SYSTEM) if block.language == "sh"
                for command in commands(block) if {"run", "conveyor.py:Conveyor-v0"}
                <= set(command.words))
    program = [sys.executable, "-c",
               f"import sys; sys.path.append({str(ROOT)!r}); "
               "from simbench_command import main; sys.exit(main())"]
    done = subprocess.run(program + list(both.words[1:]), cwd=tmp_path, capture_output=True,
                          text=True, check=False)
    assert done.returncode == 0, done.stderr
    metrics = json.loads((tmp_path / "both" / "metrics.json").read_text())
    assert metrics["camera"]["coverage"] == 1.0
    # The camera goes 10 mm a frame. Flow from images of 320 px errs by a tenth of a pixel or so,
    # which is 1 mm at the wall's 5 m.
    assert metrics["camera"]["E_t"] < 2e-3
    assert {block["name"] for number, block in metrics["objects"].items()
            if number != "mean"} == {"crate", "parcel"}
