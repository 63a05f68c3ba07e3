from __future__ import annotations

from support.read_here import read_here

__all__ = ["read_here"]
