"""Models of loss as one thing: a Markov chain that loses messages with a probability per state."""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Sequence

import numpy as np

from plotfeed.feeds.scene.link_keys import FourState, GilbertElliott, Loss, RandomLoss
from plotfeed.models.numerics import nan_without_warnings
from plotfeed.models.state import Floats


def until_left(steps: Floats, leaving: Floats, each: Floats) -> Floats:
    """Expected sum of `each`, (n,), over the states from a start in each until the chain leaves.

    `steps`, (n, n), lead from row to column, `leaving` out. What stays in a state is not asked for:
    1 less a chance of 1e-100 is 1, and a matrix of such is singular. Grassmann, Taksar and Heyman,
    Operations Research 33 (1985). Infinite where the chain cannot leave.
    """
    n = len(steps)
    a, out, total = steps.copy(), leaving.tolist(), each.tolist()
    away = [0.0] * n
    for k in reversed(range(n)):
        away[k] = out[k] + float(a[k, :k].sum())
        for i in range(k):
            share = a[i, k] / away[k] if a[i, k] and away[k] else 0.0
            a[i, :k] += share * a[k, :k]
            out[i] += share * out[k]
            total[i] = math.inf if a[i, k] and not away[k] else total[i] + share * total[k]
    found = np.empty(n)
    for k in range(n):
        met = sum((a[k, j] * found[j] for j in range(k) if a[k, j]), total[k])
        found[k] = met / away[k] if away[k] else math.inf
    return found


BELOW_ONE = math.nextafter(1.0, 0.0)
STEP = 1e-3  # Of tilts, by which moments are derived


def left_of(u: float, p: float) -> float:
    """A uniform number that chose between u < p and its contrary: what is left of it is uniform."""
    return min(u / p if u < p else (u - p) / (1 - p), BELOW_ONE)


class LossChain:
    """`transitions[i][j]` leads from state i to j, which loses a message by `emissions[j]`.

    States are in the order in which a uniform number chooses among them. Two runs that draw the
    same numbers from different states meet in one state after some messages, and stay together.
    `edges` and `targets` have a row more than there are states: where nothing came before.
    """

    def __init__(
        self,
        transitions: Sequence[Sequence[float]],
        emissions: Sequence[float],
        weights: Sequence[float],
    ) -> None:
        """`weights` are in proportion to the stationary law."""
        # Probabilities from state to state, rows to columns.
        self.steps: Floats = np.array(transitions)
        self._e = np.array(emissions)
        self.start = len(emissions)  # Stands for a state where there is none yet
        self.emissions = tuple(emissions)
        self.stationary = np.array(weights) / sum(weights)
        rows = [_row(row) for row in (*transitions, self.stationary.tolist())]
        self.edges = tuple(edges for edges, _ in rows)
        self.targets = tuple(targets for _, targets in rows)

    def repeats(self, before: int, u: float, v: float, most: int) -> tuple[int, int]:
        """How often a lost message is sent again until it passes, and the state after that.

        `before` is the state before the message, u and v are the numbers that chose its state and
        its loss. What an outcome leaves open of a uniform number is uniform again: so each repeat
        draws on, as a message of its own, without further numbers.
        """
        state = before
        for count in range(most + 1):
            state, u = self._step(state, u)
            emission = self.emissions[state]
            if v >= emission:
                return count, state
            v = left_of(v, emission)
        return most, state

    def _step(self, state: int, u: float) -> tuple[int, float]:
        edges = self.edges[state]
        i = bisect_right(edges, u)
        low = edges[i - 1] if i else 0.0
        high = edges[i] if i < len(edges) else 1.0
        return self.targets[state][i], min((u - low) / (high - low), BELOW_ONE)

    @property
    def mean_loss(self) -> float:
        """Share of messages that are lost."""
        return float(self.stationary @ self._e)

    @property
    def mean_burst(self) -> float:
        """Messages lost in a row; NaN where none is, infinite where all are."""
        begins = self._begins()
        if not begins.any():
            return math.inf if self.mean_loss else math.nan
        lengths = until_left(self.steps * self._e, self.steps @ (1 - self._e), np.ones(len(begins)))
        first = begins > 0
        return float(begins[first] @ lengths[first] / begins.sum())

    def burst_survival(self, longest: int) -> Floats:
        """Probability that a burst has 1, 2, ... or more messages, up to `longest`; (longest,)."""
        begins = self._begins()
        if not begins.any():
            return np.full(longest, 1.0 if self.mean_loss else np.nan)
        law, lost = begins / begins.sum(), self.steps * self._e
        survival = np.empty(longest)
        for n in range(longest):
            survival[n] = law.sum()
            law = law @ lost
        return survival

    @property
    @nan_without_warnings
    def variance_per_message(self) -> float:
        """Variance of the number of losses among many messages, per message; may be infinite.

        L(1-L) and twice the sum of all covariances: what each state brings, beside the mean, until
        the commonest one comes again (Kemeny and Snell, Finite Markov Chains).
        """
        loss, law = self.mean_loss, self.stationary
        beside, common = self._e - loss, int(law.argmax())
        others = np.arange(len(law)) != common
        brings = np.zeros(len(law))
        steps, back = self.steps[np.ix_(others, others)], self.steps[others, common]
        brings[others] = until_left(steps, back, beside[others])
        there = law > 0
        law, lost, brings = law[there], self._e[there], brings[there]
        later = (law * lost) @ (brings - law @ brings - beside[there])
        variance = float(loss * (1 - loss) + 2 * later)
        return math.inf if math.isnan(variance) else max(variance, 0.0)

    def spread_of_loss(self, messages: int) -> float:
        """Standard deviation of the share lost of so many messages, if they are many."""
        return math.sqrt(self.variance_per_message / messages)

    def p_of(self, count: int, of: int) -> float:
        """Probability of so many losses among messages that it decided on in turn; two-sided."""
        from plotfeed.models.tail_chances import Cumulants, p_of_whole  # SciPy takes long to load

        step, emissions = self.steps, self._e

        def log_moment(t: float) -> float:
            tilt = 1 - emissions + emissions * math.exp(t)
            first, matrix, log, scale = self.stationary * tilt, step * tilt, 0.0, 0.0
            vector, left = first, of - 1
            while left:
                if left & 1:
                    vector = vector @ matrix
                    size = float(vector.sum())
                    vector, log = vector / size, log + math.log(size) + scale
                matrix = matrix @ matrix
                size = float(matrix.max())
                matrix, scale = matrix / size, 2 * scale + math.log(size)
                left >>= 1
            return log + math.log(float(vector.sum()))

        def cumulants(t: float) -> Cumulants:
            below, here, above = log_moment(t - STEP), log_moment(t), log_moment(t + STEP)
            return Cumulants(
                here, (above - below) / (2 * STEP), (above - 2 * here + below) / STEP**2
            )

        return p_of_whole(count, cumulants, of)

    def _begins(self) -> Floats:
        """Probability, per message and state, of being the first of a burst."""
        begins: Floats = ((self.stationary * (1 - self._e)) @ self.steps) * self._e
        return begins


def chain_of(loss: Loss | None) -> LossChain:
    """The chain that a table of the scene asks for; without one, nothing is lost."""
    match loss:
        case None:
            return LossChain(((1.0,),), (0.0,), (1.0,))
        case RandomLoss():
            # The share p lost and the lag-1 correlation c fix both probabilities of a loss:
            # p + c(1-p) after one, p(1-c) after none.
            p, c = loss.probability, loss.correlation
            return _two_states(p * (1 - c), (1 - p) * (1 - c), 0.0, 1.0)
        case GilbertElliott():
            return _two_states(*loss.probabilities)
        case FourState():
            return _four_states(loss)


def _two_states(p: float, r: float, good_loss: float, bad_loss: float) -> LossChain:
    """Bad, good."""
    p, r = min(p, 1.0), min(r, 1.0)  # which rounding may have passed
    return LossChain(((1 - r, r), (p, 1 - p)), (bad_loss, good_loss), (p, r))


def _four_states(loss: FourState) -> LossChain:
    """The chain of netem, its states in the order 3, 4, 2, 1."""
    p13, p14, p31, p32, p23 = loss.p13, loss.p14, loss.ends, loss.p32, loss.p23
    rows = (
        (max(0.0, 1 - p31 - p32), 0.0, p32, p31),
        (0.0, 0.0, 0.0, 1.0),
        (p23, 0.0, 1 - p23, 0.0),
        (p13, p14, 0.0, max(0.0, 1 - p13 - p14)),
    )
    # What flows into a state flows out of it, each by the flow between 3 and 1.
    weights = (p13, p14 * p31, p13 * p32 / p23, p31)
    return LossChain(rows, (1.0, 1.0, 0.0, 0.0), weights)


def _row(probabilities: Sequence[float]) -> tuple[tuple[float, ...], tuple[int, ...]]:
    """Where a uniform number changes from one state to the next, and those states."""
    edges: list[float] = []
    targets: list[int] = []
    for state, probability in enumerate(probabilities):
        if probability > 0:
            targets.append(state)
            edges.append((edges[-1] if edges else 0.0) + probability)
    return tuple(edges[:-1]), tuple(targets)
