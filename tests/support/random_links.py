"""Links of random scenes: delays, losses, copies, flipped bits."""

from __future__ import annotations

from support.dice import Dice, Keys


def random_link(dice: Dice) -> Keys:
    link: Keys = {"latency_ms": dice.between(0, 200)}
    if dice.happens(0.7):
        link |= {
            "jitter_ms": dice.between(1, 40),
            "distribution": dice.one_of("normal", "uniform", "pareto", "paretonormal"),
        }
    if dice.happens(0.5):
        link["loss"] = dice.one_of(
            {"kind": "random", "probability": dice.between(0.001, 0.3)},
            {"kind": "random", "probability": 0.1, "correlation": dice.between(0, 0.6)},
            {
                "kind": "gilbert-elliott",
                "mean_loss": dice.between(0.01, 0.3),
                "mean_burst": dice.between(1.5, 8),
            },
            {"kind": "four-state", "p13": 0.02, "p31": 0.3, "p32": 0.1, "p23": 0.5},
        )
    extra = {
        "duplicate": dice.between(0.001, 0.1),
        "corrupt": dice.between(0.001, 0.1),
        "in_order": True,
        "delay_correlation": dice.between(0.1, 0.8),
    }
    link |= {key: value for key, value in extra.items() if dice.happens(0.25)}
    if "jitter_ms" not in link:
        link.pop("delay_correlation", None)
    return link
