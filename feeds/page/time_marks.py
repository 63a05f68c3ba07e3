"""What was changed in a session and when, and which stories are on, for the page to mark."""

from __future__ import annotations

from collections import deque
from typing import Any

from plotfeed.feeds.engine.change_control import told
from plotfeed.feeds.page.view import View
from plotfeed.feeds.scene.changes import Command
from plotfeed.feeds.session.observer import RunningSession

MAX_MARKS = 100  # The newest are kept


class TimeMarks:
    """Follows the changes of one session after the other, and tells a view of them."""

    def __init__(self, view: View) -> None:
        self._view = view
        self._marks: deque[dict[str, Any]] = deque(maxlen=MAX_MARKS)
        # Sensors that are otherwise, and since when, of which no command has told yet.
        self._unexplained: dict[str, int] = {}
        self._would_undo = ""

    def begin(self, session: RunningSession) -> None:
        """Another session has begun."""
        self._marks.clear()
        self._unexplained.clear()
        self._tell_stories(session)

    def settings(self, sensor: str, at_utc_ns: int) -> None:
        """A sensor is otherwise since then."""
        self._unexplained[sensor] = at_utc_ns

    def obeyed(self, session: RunningSession, command: Command, at_utc_ns: int) -> None:
        """A command has changed something then."""
        if command.clock is not None:
            return
        kind = "change" if command.story is None else "story"
        self._mark(kind, self._words(session, command), at_utc_ns)
        self._unexplained.clear()
        self._tell_stories(session)

    def look_at(self, session: RunningSession) -> None:
        """Mark what has changed by the scene's script, or by a task of SAPIENT."""
        for sensor, at_utc_ns in self._unexplained.items():
            self._mark("script", f"{sensor}: by its script", at_utc_ns)
        if self._unexplained:
            self._unexplained.clear()
            self._tell_stories(session)

    def _mark(self, kind: str, words: str, at_utc_ns: int) -> None:
        self._marks.append({"t_utc_ms": at_utc_ns / 1e6, "kind": kind, "words": words})
        self._view.marks(list(self._marks))

    def _words(self, session: RunningSession, command: Command) -> str:
        if command.undo:
            return f"Undone: {self._would_undo}"
        if command.story is not None:
            titles = {story.id: story.title for story, _ in session.changes.stories}
            words = titles.get(command.story) or command.story
            return f"{words}, taken back" if command.reset else words
        if command.drone is not None:
            happens = command.contingency.kind if command.contingency else "claim"
            return f"{command.drone}: {'as in the scene' if command.reset else happens}"
        return f"{command.sensor}: {told(command.set) if command.set else 'as in the scene'}"

    def _tell_stories(self, session: RunningSession) -> None:
        self._would_undo = session.changes.undoes
        stories = [
            {
                "id": story.id,
                "title": story.title or story.id,
                "text": story.text,
                "sensors": list(story.sets),
                "since_utc_ms": None if since_ns is None else since_ns / 1e6,
            }
            for story, since_ns in session.changes.stories
        ]
        self._view.stories(stories, self._would_undo)
