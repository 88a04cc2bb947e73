"""What the closed controller costs against the best that is known, in words with numbers."""

from __future__ import annotations

import numpy as np

from platform_ctrl.design.jobs import LoopOutcome
from platform_ctrl.design.loop import LoopDesign
from platform_ctrl.report.quantities import count, plain, quantity
from platform_ctrl.rounding import Rounding

# Of two ratios to a limit; less is not worth a sentence.
_WORTH_TELLING = 1.05


def price(outcome: LoopOutcome) -> list[str]:
    """Return sentences: order and bandwidth against the best alternative, and against bounds that are claimed."""
    return [*_against_others(outcome), *_against_bounds(outcome.closed)]


def bandwidth_hz(design: LoopDesign) -> float:
    """Return the bandwidth of the nominal loop in Hz; 0 where the loop is unstable or has no plants of its own."""
    measures = design.measures
    if measures is None or not measures.decay[0] > 0.0 or not np.isfinite(measures.bandwidth):
        return 0.0
    return measures.bandwidth / (2.0 * np.pi)


def _against_others(outcome: LoopOutcome) -> list[str]:
    """Compare with the widest of the alternatives that meet their limits; of all, where none does."""
    closed = outcome.closed
    own = bandwidth_hz(closed)
    others = [design for design in outcome.alternatives if bandwidth_hz(design) > 0.0]
    if not others or own == 0.0:
        return []
    best = max(others, key=lambda design: (design.passed, bandwidth_hz(design)))
    its = bandwidth_hz(best)
    if not best.passed:
        kept = "but misses limits"
    elif closed.passed:
        kept = "and meets every limit too"
    else:
        kept = "and meets every limit"
    text = (
        f"With {_states(closed)} “{closed.name}” reaches {quantity(own, 'Hz', 3)}; “{best.name}”, the best of the "
        f"others, reaches {quantity(its, 'Hz', 3)} with {_states(best)} {kept}"
    )
    fewer = best.controller.nstates - closed.controller.nstates
    loss, gain = _percent(1.0 - own / its), _percent(own / its - 1.0)
    if fewer > 0 and own < its:
        told = f"{loss} of bandwidth is the price of {count(fewer, 'state')} fewer"
    elif fewer > 0:
        told = f"{gain} more bandwidth with {count(fewer, 'state')} fewer"
    elif own < its:
        told = f"{loss} of bandwidth is given up without fewer states"
    else:
        told = f"{gain} more bandwidth with {count(-fewer, 'state')} more" if fewer else f"{gain} more bandwidth"
    return [f"{text}: {told}.", *_paid_in(closed, best)]


def _paid_in(closed: LoopDesign, best: LoopDesign) -> list[str]:
    """Name the limit, bandwidth apart, that `closed` comes nearer to than `best` by most; nothing below 5 %."""
    theirs = {one.name: one for one in best.results}
    # How slow the slowest pole is says little as long as it decays.
    apart = [
        (one.ratio / theirs[one.name].ratio, one)
        for one in closed.results
        if one.name in theirs and theirs[one.name].ratio > 0.0 and not one.name.startswith(("bandwidth", "slowest"))
    ]
    worse, paid = max(apart, key=lambda pair: pair[0], default=(1.0, None))
    if paid is None or not worse > _WORTH_TELLING:
        return []
    other = theirs[paid.name].value
    shown = quantity(paid.value, paid.unit, 3, like=paid.limit), quantity(other, paid.unit, 3, like=paid.limit)
    return [f"It pays most in {paid.name}: {shown[0]} against {shown[1]}."]


def _against_bounds(design: LoopDesign) -> list[str]:
    out = []
    own, claims = bandwidth_hz(design), design.claims
    bound = claims.get("bandwidth_bound_hz", np.nan)
    if np.isfinite(bound) and own > 0.0:
        most = quantity(bound, "Hz", 3, rounding="up")
        share = f": {_percent(bound / own - 1.0, 'up')} is all that any other could add" if own < bound else ""
        out.append(f"No controller within these limits reaches more than {most}{share}.")
    gamma, least = claims.get("gamma", np.nan), claims.get("gamma_optimal", np.nan)
    told = claims.get("price", gamma / least - 1.0 if least > 0.0 else np.nan)
    if np.isfinite(told) and np.isfinite(gamma) and np.isfinite(least):
        out.append(
            f"On its weights the norm is {plain(gamma, rounding='up')}, {_percent(told)} above "
            f"{plain(least, rounding='down')}, which no controller of any order undercuts."
        )
    elif np.isfinite(told):
        out.append(f"Its simplicity costs at most {_percent(told, 'up')} against the best controller of any order.")
    return out


def _states(design: LoopDesign) -> str:
    return count(design.controller.nstates, "state")


def _percent(share: float, rounding: Rounding = "nearest") -> str:
    return f"{plain(100.0 * share, 2, rounding)}\u00a0%"
