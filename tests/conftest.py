from __future__ import annotations

from hypothesis import settings

# A machine that is busy with something else makes no test wrong.
settings.register_profile("plotfeed", settings(), deadline=None)
settings.load_profile("plotfeed")
