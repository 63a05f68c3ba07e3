"""What a command needs that only an extra brings."""

from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path
from typing import Any

from plotfeed.feeds.console.printed import naming
from plotfeed.proto.errors import PlotfeedError

NO_DATE = {".png": {"Software": None}, ".svg": {"Date": None}, ".pdf": {"CreationDate": None}}
"""By suffix: what keeps the same picture the same file."""


def need_extra(module: str, what: str, extra: str) -> None:
    """Raise `PlotfeedError` if a module that only an extra brings is not installed."""
    if find_spec(module) is None:
        raise PlotfeedError(f"{what} needs {module}: pip install 'plotfeed[{extra}]'")


def check_picture(path: Path) -> None:
    """Raise `PlotfeedError` if no such picture can be drawn here."""
    if path.suffix.lower() not in NO_DATE:
        raise PlotfeedError(f"{path}: expected a name that ends in {', '.join(NO_DATE)}")
    need_matplotlib()


def save_figure(figure: Any, path: Path, **how: Any) -> None:
    """Write a figure of matplotlib; raises `OSError` with the name of the file."""
    with naming(str(path)):
        figure.savefig(path, **how)


def need_matplotlib() -> None:
    """Raise `PlotfeedError` if it is not installed: before anything is worked out in vain."""
    try:
        import matplotlib.figure  # noqa: F401 - an extra
    except ImportError:
        raise PlotfeedError("charts need matplotlib: pip install 'plotfeed[charts]'") from None
