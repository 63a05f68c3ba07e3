"""Where the figures of links fail: rows of docs/stability.md."""

from __future__ import annotations

import mpmath as mp
import numpy as np
from stability_case import Case, relative

from plotfeed.feeds.impairment.losses import chain_of
from plotfeed.feeds.scene.link_keys import GilbertElliott

TEST = "feeds/impairment/test_loss_chains.py::test_chains_that_hardly_ever_move_keep_their_figures"


def rare_changes() -> Case:
    p, r = 3e-18, 1e-18
    exact_p, exact_r = mp.mpf(p), mp.mpf(r)
    loss = exact_p / (exact_p + exact_r)
    exact = loss * (1 - loss) * (2 - exact_p - exact_r) / (exact_p + exact_r)
    steps, law = np.array([[1 - r, r], [p, 1 - p]]), np.array([p, r]) / (p + r)
    lost = np.array([1.0, 0.0])
    try:
        later = (law * lost) @ (np.linalg.inv(np.eye(2) - steps + law) - np.eye(2)) @ lost
    except np.linalg.LinAlgError:
        later = np.nan
    plain = law[0] * (1 - law[0]) + 2 * later
    chain = chain_of(GilbertElliott(kind="gilbert-elliott", p=p, r=r))
    return Case(
        where="variance of losses, states that change once in 10¹⁸ messages",
        plain_form="inverse of I − P + 1π",
        plain=relative(plain, exact),
        cure="sums until a state comes again, without a subtraction",
        ours=relative(chain.variance_per_message, exact),
        test=TEST,
    )


def endless_burst() -> Case:
    p, r = 0.5, 1e-17
    lost = np.array([[1 - r, 0.0], [p, 0.0]])
    try:
        plain = float(np.linalg.solve(np.eye(2) - lost, np.ones(2))[0])
    except np.linalg.LinAlgError:
        plain = float("nan")
    chain = chain_of(GilbertElliott(kind="gilbert-elliott", p=p, r=r))
    return Case(
        where="mean burst, one that ends with a chance of 10⁻¹⁷",
        plain_form="inverse of I − PE",
        plain=relative(plain, 1 / mp.mpf(r)),
        cure="the same sums",
        ours=relative(chain.mean_burst, 1 / mp.mpf(r)),
        test=TEST,
    )


LINKS = (rare_changes, endless_burst)
