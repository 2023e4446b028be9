"""Style of all figures: sizes for a two-column paper, colours for colour-blind readers, places of legends."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from jezero.base.files import naming

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Format = Literal["png", "pdf", "svg"]

WIDTH_IN = 7.16
"""Width of both columns of an IEEE page."""
BLUE, ORANGE, GREEN, PINK, SKY, GREY = "#0072B2", "#D55E00", "#009E73", "#CC79A7", "#56B4E9", "#666666"
"""Palette of Okabe and Ito."""
LEGEND_COLUMNS = 6
TRUTH = "black"
ESTIMATE, FLOWN = BLUE, BLUE
ESTIMATE_BAND = "#9cc8e6"
UWB, TAG = ORANGE, PINK
PICTURES = ORANGE
NO_TRUTH = "no truth in the recording"
PHASES = {
    "approach": "#dcebf5",
    "descent": "#fdebd3",
    "contact": "#d6efdf",
    "go_around": "#f6d9d2",
    "hold": "#e9e9e9",
    "search": "#f3e0ec",
}
BAND = "#bdbdbd"
STYLE: dict[Any, Any] = {
    "font.size": 8.5,
    "axes.titlesize": 9,
    "axes.linewidth": 0.7,
    "axes.grid": True,
    "axes.axisbelow": True,
    "axes.xmargin": 0.0,
    "grid.color": "0.5",
    "grid.alpha": 0.25,
    "grid.linewidth": 0.5,
    "lines.linewidth": 1.1,
    "legend.frameon": False,
    "legend.fontsize": 8,
    "legend.handlelength": 1.6,
    "savefig.dpi": 200,
    "pdf.fonttype": 42,
    "svg.hashsalt": "jezero",
}


def draw(
    path: Path,
    shape: tuple[int, int],
    height_in: float,
    fill: "Callable[[Figure, Any], None]",
    width_in: float = WIDTH_IN,
    **subplots: Any,
) -> Path:
    """Make one figure and write it.

    Args:
        path: file of the figure; its suffix gives the format.
        shape: rows and columns of axes.
        fill: draws into the figure's axes, a (rows, columns) array of them.
    """
    import matplotlib
    from matplotlib.figure import Figure
    from matplotlib.layout_engine import ConstrainedLayoutEngine

    with matplotlib.rc_context(STYLE):
        # Without space, labels touch the axes beside them.
        layout = ConstrainedLayoutEngine(wspace=0.05 if shape[1] > 1 else 0.0)
        figure = Figure(figsize=(width_in, height_in), layout=layout)
        fill(figure, figure.subplots(*shape, squeeze=False, **subplots))
        figure.align_ylabels()
        with naming(path):
            figure.savefig(path)
    return path


def shade(axes: "Sequence[Axes]", phases: Sequence[tuple[str, float, float]]) -> None:
    """Colour the background of the phases of a landing, (name, start, end) each; a legend names each phase once."""
    for ax in axes:
        for name, begin_s, end_s in phases:
            ax.axvspan(begin_s, end_s, color=PHASES[name], lw=0, zorder=0)


def note(ax: "Axes", text: str) -> None:
    """Write a remark above the left end of some axes."""
    ax.set_title(text, loc="left", fontsize=7.5, color="0.3", pad=3)


def legend_above(
    figure: "Figure",
    axes: "Sequence[Axes]",
    phases: Sequence[tuple[str, float, float]] = (),
    columns: int = LEGEND_COLUMNS,
) -> None:
    """Add one legend above all axes, with each label of `axes` once, and the phases that occur.

    Args:
        phases: name, start and end of each.
        columns: greatest number of labels side by side.
    """
    from matplotlib.patches import Patch

    named: dict[str, Any] = {}
    for ax in axes:
        for handle, label in zip(*ax.get_legend_handles_labels(), strict=True):
            named.setdefault(label, handle)
    labels, handles = list(named), list(named.values())
    for name in dict.fromkeys(name for name, _, _ in phases):
        handles.append(Patch(facecolor=PHASES[name], edgecolor="0.6", lw=0.4))
        labels.append(name)
    rows = -(-len(handles) // columns)
    figure.legend(handles, labels, loc="outside upper center", ncols=-(-len(handles) // rows), columnspacing=1.3)
