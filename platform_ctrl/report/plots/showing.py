"""Windows for plots that exist already: the only place where pyplot comes in, and only when it is called."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from matplotlib.figure import Figure

from platform_ctrl.errors import ArgumentError
from platform_ctrl.signatures import short

if TYPE_CHECKING:
    import control


def show(*plots: Figure | control.ControlPlot) -> None:
    """Open a window for each plot, by pyplot's current backend, and wait until they are closed.

    In a notebook they appear below the cell instead, and nothing waits. Until this is called no plot of this package
    is known to pyplot.

    Parameters
    ----------
    *plots
        Figures, and whatever has one as ``figure``: `control.ControlPlot`.

    Raises
    ------
    ArgumentError
        Something else, nothing at all, or a backend that opens no windows: use ``figure.savefig`` there.

    References
    ----------
    Own definition.
    """
    figures = [_figure(plot) for plot in plots]
    if not figures:
        raise ArgumentError("show: given no plot; expected at least one Figure or control.ControlPlot")
    from matplotlib import pyplot

    backend = pyplot.get_backend()
    if _is_silent(backend):
        raise ArgumentError(
            f"show: Matplotlib's backend {backend!r} opens no windows; "
            "save the figure with figure.savefig('plot.png'), or choose another with matplotlib.use('TkAgg')"
        )
    for figure in figures:
        _attached(pyplot, figure)
    pyplot.show()


def _figure(plot: object) -> Figure:
    figure = plot if isinstance(plot, Figure) else getattr(plot, "figure", None)
    if not isinstance(figure, Figure):
        raise ArgumentError(f"show: given {short(plot)}; expected a Figure or a control.ControlPlot")
    return figure


def _is_silent(backend: str) -> bool:
    from matplotlib.backends.registry import BackendFilter, backend_registry

    names: list[str] = backend_registry.list_builtin(BackendFilter.NON_INTERACTIVE)  # type: ignore[no-untyped-call]
    return backend.lower() in {name.lower() for name in names}


def _attached(pyplot: Any, figure: Figure) -> None:
    """Give `figure` the window of a figure that pyplot makes: the way that every version of Matplotlib has."""
    manager = figure.canvas.manager
    if manager is not None and pyplot.fignum_exists(manager.num):
        return
    manager = pyplot.figure(figsize=figure.get_size_inches(), dpi=figure.dpi).canvas.manager
    manager.canvas.figure = figure
    figure.set_canvas(manager.canvas)
