"""What mkdocs needs beside docs/ to build the site, by `make docs`: mkdocs.yml names this file.

Pages stand in the order of docs/README.md. Some of them lie elsewhere in the clone; other files of
the clone are no part of the site, and are named there without a link.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[2]
# Pages of the site that lie beside docs/.
ELSEWHERE = ("examples/README.md", "CONTRIBUTING.md", "CHANGELOG.md")
ENTRY = re.compile(
    r"^(?:## (?P<task>.+)|- \[(?P<title>[^]]+)\]\((?P<page>[^)#]+)\).*)$", re.MULTILINE
)
LINK = re.compile(r"(?<!!)\[(?P<text>[^]]+)\]\((?P<target>[^):#]+)(?P<anchor>#[^)]*)?\)")


def navigation(index: str) -> list[dict[str, Any]]:
    """Tasks with their pages, as the index has them."""
    tasks: list[dict[str, Any]] = [{"All": "README.md"}]
    for entry in ENTRY.finditer(index):
        if entry["task"]:
            tasks.append({entry["task"]: []})
        elif isinstance(pages := next(iter(tasks[-1].values())), list):
            pages.append({entry["title"]: entry["page"].removeprefix("../")})
    return tasks


def linked(text: str, folder: Path) -> str:
    """A page in which links lead within the site; what else is linked to is named alone."""

    def link(found: re.Match[str]) -> str:
        target = (ROOT / folder / found["target"]).resolve().relative_to(ROOT).as_posix()
        home = "" if folder.as_posix() in {"docs", "."} else "../"
        if target.startswith("docs/") and not target.startswith("docs/commands"):
            place = target.removeprefix("docs/")
        elif target in ELSEWHERE:
            place = target
        else:
            return f'<span title="{target}">{found["text"]}</span>'
        return f"[{found['text']}]({home}{place}{found['anchor'] or ''})"

    return LINK.sub(link, text)


def on_config(config: Any) -> Any:
    """mkdocs asks: the navigation is that of the index."""
    config.nav = navigation((ROOT / "docs" / "README.md").read_text(encoding="utf-8"))
    return config


def on_files(files: Any, config: Any) -> Any:
    """mkdocs asks: pages from beside docs/ are added."""
    from mkdocs.structure.files import File

    for page in ELSEWHERE:
        files.append(File.generated(config, page, abs_src_path=str(ROOT / page)))
    return files


def on_page_markdown(markdown: str, page: Any, **_: Any) -> str:
    """mkdocs asks: links as they are to be in the site."""
    name = Path(page.file.src_uri)
    return linked(markdown, name.parent if name.as_posix() in ELSEWHERE else "docs" / name.parent)
