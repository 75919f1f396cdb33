"""Curves through a traced surface: how high a standing wave is."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from jaxmps.diagnostics.tracing import trace
from jaxmps.results import Run
from jaxmps.validation import not_negative, positive

_DEPENDENT = 1e-9  # columns of a fit, of order one, with a singular value below this part of the largest fix nothing


class Parabola(NamedTuple):
    """y = a x² + b x + c: `a` [1/m], `b` [-] and `c` [m], the vertex (`x_max`, `y_max`) [m], the mean relative `error`
    [-], and whether the curve is `conditioned`, bent enough to have a vertex that means something.
    """

    a: Float[np.ndarray, "*frames"]
    b: Float[np.ndarray, "*frames"]
    c: Float[np.ndarray, "*frames"]
    x_max: Float[np.ndarray, "*frames"]
    y_max: Float[np.ndarray, "*frames"]
    error: Float[np.ndarray, "*frames"]
    conditioned: Bool[np.ndarray, "*frames"]


class Cosine(NamedTuple):
    """A sum of cosines: `mean` [m]; of each mode, from the longest, the `amplitude` [m] and where the first `crest` is
    [m], in [0, L / mode); and the elevation [m] at the `center` x = L / 2.
    """

    mean: Float[np.ndarray, "*frames"]
    amplitude: Float[np.ndarray, "*frames modes"]
    crest: Float[np.ndarray, "*frames modes"]
    center: Float[np.ndarray, "*frames"]


class WaveFit(NamedTuple):
    """The wave in each frame, at `time` [s]; NaN where its surface is not `complete`.

    By a parabola: the height of its `vertex` above the still level [m], negative for a trough, and its mean relative
    `error` [-]. By cosines: `amplitude` [m] and `crest` [m] of each mode as in `Cosine`, from the left end, and the
    elevation at the `center` above the still level [m].
    """

    time: Float[np.ndarray, " m"]
    vertex: Float[np.ndarray, " m"]
    error: Float[np.ndarray, " m"]
    amplitude: Float[np.ndarray, "m modes"]
    crest: Float[np.ndarray, "m modes"]
    center: Float[np.ndarray, " m"]
    complete: Bool[np.ndarray, " m"]


def fit_parabola(
    x: Float[np.ndarray, "*frames k"], y: Float[np.ndarray, "*frames k"], length: float, flat: float = 0.01
) -> Parabola:
    """The parabola y = a x² + b x + c through points [m] by least squares ([N11] Eq. 23), in each frame.

    Points with NaN are padding. The vertex is at x_max = −b / 2a, held within [0, `length`], and y_max is the curve
    there (Eq. 24). Where |a| `length` < `flat`, the curve is as good as straight, −b / 2a is noise, and the vertex is
    put in the middle; 0.01 is a rise of a 400th of the length. Error: the mean of |y_fit − y| / y_fit over the points
    (Eq. 25, whose sum has N + 1 terms over N), a fraction; heights are to be above the floor, and where the fit goes
    below y = 0 the error is NaN. All is NaN where fewer than three different x are left.

    Over one wavelength of A cos(k (x − L/2)) it has its vertex at 7.5 / π² A = 0.760 A: less than the wave's height.
    """
    x, y, there = _points(x, y)
    length = positive("length", length, "m")
    not_negative("flat", flat)
    s = x / length - 0.5  # within ±1/2, or the columns 1, x and x² are hard to tell apart
    design = np.stack([np.ones_like(s), s, s**2], axis=-1)
    coefficients, fitted = _least_squares(design, y, there)
    p, q, r = np.moveaxis(coefficients, -1, 0)
    conditioned = np.abs(r) >= flat * length
    top = np.clip(np.where(conditioned, -q / np.where(conditioned, 2.0 * r, 1.0), 0.0), -0.5, 0.5)
    count = there.sum(axis=-1)
    above = np.all((fitted > 0.0) | ~there, axis=-1)
    relative = np.abs(fitted - y) / np.where(there & above[..., None], fitted, 1.0)
    error = np.where(above, np.where(there, relative, 0.0).sum(axis=-1) / np.maximum(count, 1), np.nan)
    solved = np.isfinite(p)
    columns = (
        r / length**2,
        (q - r) / length,
        p - 0.5 * q + 0.25 * r,
        np.where(solved, (top + 0.5) * length, np.nan),
        p + q * top + r * top**2,
        np.where(solved, error, np.nan),
    )
    return Parabola(*map(np.asarray, columns), conditioned=np.asarray(conditioned))


def fit_cosine(
    x: Float[np.ndarray, "*frames k"], y: Float[np.ndarray, "*frames k"], length: float, modes: int = 2
) -> Cosine:
    """y = c + Σ_m (a_m cos(2π m x / L) + b_m sin(2π m x / L)), m = 1 to `modes`, through points [m] by least squares.

    L is the `length` [m]. The points need not be equidistant; those with NaN are padding. All is NaN where too few
    are left to tell the 2 `modes` + 1 terms apart. `ValueError` unless there is a mode.
    """
    if modes < 1:
        raise ValueError(f"modes must be 1 or more, got {modes}")
    x, y, there = _points(x, y)
    length = positive("length", length, "m")
    mode = np.arange(1, modes + 1)
    turn = 2.0 * np.pi * mode * x[..., None] / length
    design = np.concatenate([np.ones_like(x)[..., None], np.cos(turn), np.sin(turn)], axis=-1)
    coefficients, _ = _least_squares(design, y, there)
    mean, cosine, sine = coefficients[..., 0], coefficients[..., 1 : modes + 1], coefficients[..., modes + 1 :]
    turns = np.arctan2(sine, cosine) / (2.0 * np.pi) % 1.0 % 1.0  # of a tiny negative one the first % 1 makes 1
    crest = turns * length / mode
    center = mean + np.sum(cosine * (-1.0) ** mode, axis=-1)
    return Cosine(np.asarray(mean), np.hypot(cosine, sine), crest, np.asarray(center))


def wave_fit(
    run: Run,
    period: float,
    level: float | None = None,
    left: float = 0.0,
    ratio: float = 2.1,
    sparsest: float = 0.4,
    modes: int = 2,
) -> WaveFit:
    """The wave of a 2-D run that is periodic in x, over a floor at y = 0, by curves through its traced surface.

    `period` [m] is the length of the domain, which begins at x = `left` [m]. The surface lies half a spacing above the
    centers of the particles that `trace` finds with `ratio` and `sparsest`. Heights are above the still `level` [m],
    by default that of the fluid in the first frame if each particle takes up l0². `ValueError` if the run is 3-D.
    """
    surfaces = trace(run, ratio, period, sparsest)
    if level is None:
        level = float(np.sum(run.fluid[:1])) * run.spacing**2 / period
    complete = np.array([surface.complete for surface in surfaces], bool)
    longest = max((len(surface.particles) for surface in surfaces), default=0)
    x, y = np.full((2, len(run), longest), np.nan)
    for k, surface in enumerate(surfaces):
        if surface.complete:
            place = run.position[k, surface.particles].astype(float)
            x[k, : len(place)] = (place[:, 0] - left) % period
            y[k, : len(place)] = place[:, 1] + 0.5 * run.spacing
    parabola, cosine = fit_parabola(x, y, period), fit_cosine(x, y, period, modes)
    return WaveFit(
        time=np.asarray(run.time, float),
        vertex=parabola.y_max - level,
        error=parabola.error,
        amplitude=cosine.amplitude,
        crest=cosine.crest,
        center=cosine.center - level,
        complete=complete,
    )


def _points(x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The points with zeros for padding, and which are there."""
    x, y = np.asarray(x, float), np.asarray(y, float)
    if x.shape != y.shape:
        raise ValueError(f"x and y must have one shape, got {x.shape} and {y.shape}")
    there = np.isfinite(x) & np.isfinite(y)
    return np.where(there, x, 0.0), np.where(there, y, 0.0), there


def _least_squares(design: np.ndarray, y: np.ndarray, there: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Coefficients and fitted values, of each frame at once; NaN and 0 where the points do not fix the coefficients."""
    terms = design.shape[-1]
    lack = max(terms - design.shape[-2], 0)  # zero rows change nothing, and there are as many singular values as terms
    rows = np.where(there[..., None], design, 0.0)
    rows = np.concatenate([rows, np.zeros((*rows.shape[:-2], lack, terms))], axis=-2)
    u, s, v = np.linalg.svd(rows, full_matrices=False)
    solved = s[..., -1] > _DEPENDENT * s[..., 0]
    projected = np.einsum("...kp,...k->...p", u[..., : y.shape[-1], :], y)
    inverse = np.where(solved[..., None], projected / np.where(solved[..., None], s, 1.0), 0.0)
    coefficients = np.einsum("...pc,...p->...c", v, inverse)
    fitted = np.einsum("...kc,...c->...k", design, coefficients)
    return np.where(solved[..., None], coefficients, np.nan), fitted
