"""What the documentation site is made of beside docs/*.md: the pages that stand at the root.

mkdocs calls these hooks (mkdocs.yml). Links keep working on both sides: the root's pages lead to
docs/x.md, which is x.md on the site.
"""

from __future__ import annotations

import re
from pathlib import Path

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files

ROOT = Path(__file__).resolve().parents[1]
ROOT_PAGES = {"README.md": "index.md", "CONTRIBUTING.md": "contributing.md",
              "CHANGELOG.md": "changelog.md"}


def on_config(config: MkDocsConfig) -> MkDocsConfig:
    """One page for each scene that has one, in the place that mkdocs.yml keeps for them."""
    scenes = sorted(f"scenes/{path.name}" for path in (ROOT / "docs" / "scenes").glob("*.md"))
    for entry in config.nav or []:
        if isinstance(entry, dict) and "Scenes" in entry:
            entry["Scenes"] = scenes
    return config


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """The root's pages, under their names on the site."""
    for source, name in ROOT_PAGES.items():
        files.append(File.generated(config, name, content=_relinked(source)))
    files.append(File.generated(config, "examples.md", content=_examples()))
    return files


def _relinked(source: str) -> str:
    """A root page whose links to documents are links within the site."""
    text = (ROOT / source).read_text()
    text = text.replace("](docs/", "](").replace("](examples/README.md)", "](examples.md)")
    for page, name in ROOT_PAGES.items():
        text = text.replace(f"]({page})", f"]({name})")
    return text


def _examples() -> str:
    """The table of the examples, and each of them whole below it."""
    folder = ROOT / "examples"
    text = re.sub(r"\]\((\w+)\.py\)", r"](#\1py)", (folder / "README.md").read_text())
    return text + "".join(f"\n## {path.name}\n\n```python\n{path.read_text()}```\n"
                          for path in sorted(folder.glob("*.py")))
