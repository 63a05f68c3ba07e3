"""The scenes that come with plotfeed, and what each of them is about."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache
from importlib.resources import files
from types import MappingProxyType
from typing import NamedTuple

# The line before a list of what is to be seen, each entry after a hyphen.
LOOK_FOR = "What to look for"
DIRECTIVE = "#:"
# Characters of the words, and entries of the list, that are read at most.
MAX_WORDS, MAX_LISTED = 300, 20


class SceneHead(NamedTuple):
    """What a scene is about."""

    words: str
    """The first paragraph of its comment; empty where there is none."""
    look_for: tuple[str, ...]

    @property
    def summary(self) -> str:
        """The first sentence, up to what a colon explains, without its full stop."""
        return self.words.partition(": ")[0].partition(". ")[0].removesuffix(".")


def head_of(text: str) -> SceneHead:
    """Read the head of a scene's TOML."""
    first, *others = [*_paragraphs(text), [""]]
    listed = next((lines[1:] for lines in others if lines[0] == LOOK_FOR), [])
    entries: list[str] = []
    for line in listed:
        if line.startswith("- "):
            entries.append(line.removeprefix("- "))
        elif entries:
            entries[-1] += f" {line}"
    return SceneHead(" ".join(first)[:MAX_WORDS], tuple(entries[:MAX_LISTED]))


def _paragraphs(text: str) -> Iterator[list[str]]:
    """Paragraphs of the comment that the text begins with, as lines."""
    lines: list[str] = []
    for line in text.splitlines():
        if not line.startswith("#"):
            break
        said = line.removeprefix("#").strip()
        if line.startswith(DIRECTIVE) or said:
            lines += [said] * (not line.startswith(DIRECTIVE))
        elif lines:
            yield lines
            lines = []
    if lines:
        yield lines


FIRST = "field-day"  # Listed before the others: the one of the demo


@cache
def summaries() -> MappingProxyType[str, str]:
    """What each scene is about, in a sentence, by its name: the first one that its file says."""
    found = {
        file.name.removesuffix(".toml"): head_of(file.read_text(encoding="utf-8")).summary
        for file in files(__name__).iterdir()
        if file.name.endswith(".toml")
    }
    names = sorted(found, key=lambda name: (name != FIRST, name))
    return MappingProxyType({name: found[name] for name in names})
