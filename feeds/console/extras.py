"""What a command needs that only an extra brings."""

from __future__ import annotations

from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from plotfeed.feeds.console.printed import naming
from plotfeed.proto.errors import PlotfeedError

# By suffix: what keeps the same picture the same file.
NO_DATE = {".png": {"Software": None}, ".svg": {"Date": None}, ".pdf": {"CreationDate": None}}


def need_extra(module: str, what: str, extra: str, *, load: bool = True) -> None:
    """Raise `PlotfeedError` if a module that only an extra brings is not there, or does not load.

    Without `load` it is only looked for.
    """
    try:
        found = import_module(module) if load else find_spec(module)
    except ImportError:
        found = None
    if found is None:
        package = module.partition(".")[0]
        raise PlotfeedError(f"{what} needs {package}: pip install 'plotfeed[{extra}]'")


def check_picture(path: Path) -> None:
    """Raise `PlotfeedError` if no such picture can be drawn here."""
    if path.suffix.lower() not in NO_DATE:
        raise PlotfeedError(f"{path}: expected a name that ends in {', '.join(NO_DATE)}")
    need_extra("matplotlib.figure", "a chart", "charts")


def save_figure(figure: Any, path: Path, **how: Any) -> None:
    """Write a figure of matplotlib; raises `OSError` with the name of the file."""
    with naming(str(path)):
        figure.savefig(path, **how)
