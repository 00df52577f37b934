"""What the pages on laws share: laws and their colours, growth of a motion, panels."""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

import numpy as np

from rbsd_sym import Consistent, Intrinsic, Model, ModelWarning, Standard
from rbsd_sym.plots.style import COLOURS, STYLES

if TYPE_CHECKING:
    from matplotlib.figure import Figure

LAWS: dict[str, Any] = {
    "Standard": Standard(),
    "Intrinsic": Intrinsic(),
    "Consistent": Consistent(),
}
LAW_COLOURS = {"Standard": COLOURS[1], "Intrinsic": COLOURS[2], "Consistent": COLOURS[0]}
LAW_STYLES = {"Standard": STYLES[0], "Intrinsic": STYLES[1], "Consistent": STYLES[2]}
# Number of samples of a growing signal that are used.
_SAMPLES = 100


@contextmanager
def known_trouble() -> Iterator[None]:
    """Suppress warnings about the failure that a page demonstrates."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ModelWarning)
        yield


def state(model: Model, **values: float) -> np.ndarray:
    """Return the start of a model with some states replaced; "__" in a name means a dot."""
    x = {label.name: label.start for label in model.x_labels}
    x |= {name.replace("__", "."): value for name, value in values.items()}
    return np.array(list(x.values()), float)


def spectrum(model: Model, x: np.ndarray) -> np.ndarray:
    """Return the eigenvalues (n,) of dode_dx at a state, 1/s."""
    return np.linalg.eigvals(np.array(model.function("dode_dx")(0, x, [], [], [])))


def spectrum_with(model: Model, params: Mapping[str, float]) -> np.ndarray:
    """Return the eigenvalues (n,) of dode_dx at the start, with some parameters replaced, 1/s."""
    p = [params.get(label.name, label.start) for label in model.dae.p_labels]
    return np.linalg.eigvals(np.array(model.function("dode_dx")(0, state(model), [], [], p)))


def growth_rate(t: np.ndarray, y: np.ndarray, order: int = 2) -> float:
    """Return the growth (1/s) of a signal that is a sum of `order` exponentials.

    It follows from the linear recursion of the samples [Prony 1795], with each equation scaled to
    size 1.

    Arguments:
        t: equally spaced times (n,), s.
        y: real or complex samples (n,).
        order: number of exponentials.
    """
    stride = max(1, len(t) // _SAMPLES)
    t, y = t[::stride], y[::stride]
    past = np.column_stack([y[order - 1 - k : len(y) - 1 - k] for k in range(order)])
    size = np.linalg.norm(past, axis=1)
    # y_n = a_1 y_(n-1) + ... with characteristic roots exp(s dt); scaling keeps early, small
    # samples.
    factors, *_ = np.linalg.lstsq(past / size[:, None], y[order:] / size, rcond=None)
    largest = np.abs(np.roots([1.0, *-factors])).max()
    return float(np.log(largest) / (t[1] - t[0]))


def turn_x(angle: float) -> np.ndarray:
    """Return the rotation matrix (3, 3) about x for an angle in rad."""
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[1, 0, 0], [0, c, -s], [0, s, c]])


def panels(widths: Sequence[float] = (1.0, 1.0), height: float = 4.0) -> tuple[Figure, list[Any]]:
    """Return a figure and its panels side by side, with relative widths and a height in inches."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(4.8 * len(widths), height), layout="constrained")
    axes = figure.subplots(1, len(widths), squeeze=False, width_ratios=list(widths))[0]
    for panel in axes:
        panel.grid(alpha=0.3)
    return figure, list(axes)


def legend_below(figure: Figure, panel: Any, columns: int) -> None:
    """Put one legend for all panels beneath them."""
    handles, labels = panel.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=columns, frameon=False)
