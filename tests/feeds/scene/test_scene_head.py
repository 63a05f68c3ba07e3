from __future__ import annotations

from plotfeed.feeds.scene.examples import MAX_LISTED, MAX_WORDS, head_of, summaries
from plotfeed.feeds.scene.scene import example

HEAD = """#:schema scene.schema.json
# A coast at night: two radars,
# and fog. Nobody sees much.
#
# What to look for
# - The first radar
#   is late.
# - The second is not.
#
# The map is drawn by hand.

[scene]
# - not of the head
"""


def test_the_head_says_what_there_is_to_see() -> None:
    head = head_of(HEAD)
    assert head.words == "A coast at night: two radars, and fog. Nobody sees much."
    assert head.summary == "A coast at night"
    assert head.look_for == ("The first radar is late.", "The second is not.")


def test_a_scene_need_not_say_anything() -> None:
    for text in ("", "[scene]\nname = 'x'\n", "#:schema s.json\n[scene]\n", "#\n#\n"):
        assert head_of(text) == ("", ())


def test_a_head_without_end_is_cut() -> None:
    words, look_for = head_of("# " + "x" * 1000 + "\n#\n# What to look for\n" + "# - y\n" * 100)
    assert len(words) == MAX_WORDS
    assert len(look_for) == MAX_LISTED


def test_every_shipped_scene_says_what_it_is() -> None:
    for name, summary in summaries().items():
        head = head_of(example(name).text)
        assert head.summary == summary != ""
        assert len(head.words) < MAX_WORDS
