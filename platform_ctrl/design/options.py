"""The numbers of a method: those that the job file gives over the method's own."""

from __future__ import annotations

from platform_ctrl.errors import DesignError


def completed(method: str, given: dict[str, float], defaults: dict[str, float]) -> dict[str, float]:
    """Return `defaults` with the `given` numbers in place.

    Raises
    ------
    DesignError
        A given option has no meaning for this loop, or an option is not positive.
    """
    unused = sorted(set(given) - set(defaults))
    if unused:
        raise DesignError(
            f"{method}: option {unused[0]!r} has no meaning for this loop; expected some of {', '.join(defaults)}"
        )
    out = defaults | given
    wrong = [name for name, x in out.items() if not x > 0.0]
    if wrong:
        raise DesignError(f"{method}: {wrong[0]} = {out[wrong[0]]:g}; expected a number > 0")
    return out
