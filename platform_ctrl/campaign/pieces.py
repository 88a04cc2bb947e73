"""Which runs are flown next: pieces that take about a second, and what becomes of those whose worker died."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable

# Scenarios that the kernel flies side by side, as in `platform_ctrl.lanes`, which would load numba: a piece of fewer
# costs as much.
LANES = 8
# Smallest and largest piece by device: a GPU wants many runs at once.
SIZES = {"cpu": (LANES, 4096), "cuda": (1 << 12, 1 << 17)}
SECONDS = 1.0
# A piece whose worker died is flown again in so many parts, until the run that it died of is alone.
_PARTS = 8
# A run that was alone when its worker died may have been unlucky: memory was short, somebody stopped the machine.
_CHANCES = 2


class Pieces:
    """The runs that are still to be flown, cut to size.

    Parameters
    ----------
    gaps
        Runs to be flown, in order.
    crew
        How many pieces are flown at a time.
    device
        ``"cpu"`` or ``"cuda"``.
    """

    def __init__(self, gaps: Iterable[range], crew: int, device: str = "cpu") -> None:
        self._gaps = deque(gap for gap in gaps if gap)
        self._again: deque[range] = deque()
        self._deaths: dict[int, int] = {}
        self._smallest, self._largest = SIZES[device]
        self._size = self._smallest
        self.crew = crew

    @property
    def waiting(self) -> bool:
        """Whether runs wait for a worker."""
        return bool(self._gaps or self._again)

    @property
    def most(self) -> int:
        """How many workers the waiting runs could occupy at most."""
        return len(self._again) + sum(-(-len(gap) // self._smallest) for gap in self._gaps)

    def next(self) -> range | None:
        """Return the next piece, or None."""
        if self._again:
            return self._again.popleft()
        if not self._gaps:
            return None
        gap = self._gaps.popleft()
        # Toward the end smaller ones, so that no worker waits long for the last; lanes stay full.
        share = max(sum(map(len, (gap, *self._gaps))) // (2 * self.crew), self._size // _PARTS)
        size = max(self._smallest, min(self._size, -(-share // LANES) * LANES))
        stop = min(gap.stop, gap.start // LANES * LANES + size)
        if stop < gap.stop:
            self._gaps.appendleft(range(stop, gap.stop))
        return range(gap.start, stop)

    def finished(self, piece: range, seconds: float) -> None:
        """Learn from a piece that took so long how large the next ones should be."""
        wanted = SECONDS * len(piece) / max(seconds, 1e-6)
        self._size = int(max(self._smallest, min(wanted // LANES * LANES, 2 * self._size, self._largest)))

    def died(self, piece: range) -> int | None:
        """Take back the piece of a worker that died; return the run that it died of once that is known."""
        if len(piece) == 1:
            run = piece.start
            self._deaths[run] = self._deaths.get(run, 0) + 1
            if self._deaths[run] >= _CHANCES:
                del self._deaths[run]
                return run
        length = -(-len(piece) // _PARTS)
        self._again.extend(piece[k : k + length] for k in range(0, len(piece), length))
        return None
