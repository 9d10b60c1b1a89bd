"""Minimisers for the fits of the engine: over torch tensors, whose derivatives come from automatic differentiation.

:func:`lbfgs` for losses of many unknowns, :func:`gauss_newton` for residuals of few, :func:`simplex` for losses without
derivatives (rays that hit or miss, medians). All run in float64 and on one thread, so that sums are added up in the
same order on every machine: the same start gives the same bytes.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

LBFGS_HISTORY = 20
"""Pairs of steps and gradients from which the curvature is estimated."""
LBFGS_TOLERANCE, LBFGS_MIN_GRADIENT = 2e-9, 1e-5
"""Relative decrease of the loss in one iteration, and largest derivative, at which L-BFGS has converged."""
SUFFICIENT_DECREASE, MAX_SLOPE, LINE_EVALUATIONS, LINE_GROWTH = 1e-4, 0.9, 20, 4.0
"""Wolfe conditions of the line search, relative to the slope at its start; evaluations at most; factor of the next
length where the loss still falls."""
DAMPING, MIN_DAMPING, MAX_DAMPING = 1e-3, 1e-12, 1e12
"""Of Gauss-Newton: the first damping relative to the diagonal of the normal equations, and its limits."""
MIN_CURVATURE = 1e-12
"""Curvature assumed at least of every unknown, relative to the largest: one that no residual feels stays."""
POOR_STEP, GOOD_STEP = 0.25, 0.75
"""Share of the predicted decrease of the loss below and above which the damping is raised and lowered."""

FloatArray = NDArray[np.float64]


def lbfgs(loss: Callable[[Tensor], Tensor], start: Tensor, iterations: int) -> Tensor:
    """The minimum of ``loss`` near ``start`` (n,), by L-BFGS with a strong Wolfe line search.

    Algorithms 7.4, 3.5 and 3.6 of Nocedal and Wright 2006.

    Args:
        loss: of unknowns (n,), differentiable.
        iterations: at most.
    """

    def at(x: Tensor) -> tuple[float, Tensor]:
        x = x.detach().requires_grad_()
        value = loss(x)
        return value.item(), torch.autograd.grad(value, x)[0]

    x, pairs = start.detach().to(torch.float64), deque[_Pair](maxlen=LBFGS_HISTORY)
    with one_thread():
        value, gradient = at(x)
        for _ in range(iterations):
            if float(gradient.abs().max()) < LBFGS_MIN_GRADIENT:
                break
            direction = -_inverse_hessian(pairs, gradient)
            origin = _Point(0.0, value, float(gradient @ direction), gradient)
            found = _line_search(at, x, direction, origin, 1.0 if pairs else min(1.0, 1 / float(gradient.norm())))
            if found is origin:
                if not pairs:
                    break
                pairs.clear()  # once more, straight downhill
                continue
            step, change = found.length * direction, found.gradient - gradient
            if (along := float(change @ step)) > 0:
                pairs.append(_Pair(step, change, along))
            decrease = value - found.value
            x, value, gradient = x + step, found.value, found.gradient
            if decrease <= LBFGS_TOLERANCE * max(abs(value), 1.0):
                break
    return x


class _Pair(NamedTuple):
    """A step (n,), the change of the gradient along it (n,), and their product."""

    step: Tensor
    change: Tensor
    along: float


def _inverse_hessian(pairs: Sequence[_Pair], gradient: Tensor) -> Tensor:
    """The estimated inverse Hessian times ``gradient`` (n,), from pairs of steps and changes of the gradient."""
    result, shares = gradient.clone(), []
    for step, change, along in reversed(pairs):
        shares.append(float(step @ result) / along)
        result.sub_(change, alpha=shares[-1])
    if pairs:
        result *= pairs[-1].along / float(pairs[-1].change.square().sum())
    for (step, change, along), share in zip(pairs, reversed(shares), strict=True):
        result.add_(step, alpha=share - float(change @ result) / along)
    return result


class _Point(NamedTuple):
    """A loss at a length along a line, with its slope along the line and its gradient (n,)."""

    length: float
    value: float
    slope: float
    gradient: Tensor


def _line_search(
    at: Callable[[Tensor], tuple[float, Tensor]], start: Tensor, direction: Tensor, origin: _Point, length: float
) -> _Point:
    """A point along ``direction`` that meets both Wolfe conditions, or else the lowest found.

    Args:
        at: loss and gradient of unknowns (n,).
        origin: the point of length 0 at ``start``.
        length: to try first.
    """
    low, high = origin, None
    for _ in range(LINE_EVALUATIONS if origin.slope < 0 else 0):
        value, gradient = at(start + length * direction)
        point = _Point(length, value, float(gradient @ direction), gradient)
        if not value <= origin.value + SUFFICIENT_DECREASE * length * origin.slope or value >= low.value:
            high = point
        elif abs(point.slope) <= -MAX_SLOPE * origin.slope:
            return point
        else:
            if point.slope * (1.0 if high is None else high.length - low.length) >= 0:
                high = low
            low = point
        length = LINE_GROWTH * length if high is None else _between(low, high)
    return low


def _between(a: _Point, b: _Point) -> float:
    """Length at the minimum of the cubic through two points (Nocedal and Wright, 3.59), away from either."""
    apart = b.length - a.length
    middle = a.slope + b.slope - 3 * (b.value - a.value) / apart
    square = middle**2 - a.slope * b.slope
    share = 0.5
    if np.isfinite(square) and square >= 0:
        root = float(np.copysign(np.sqrt(square), apart))
        below = b.slope - a.slope + 2 * root
        share = 1 - (b.slope + root - middle) / below if below else 0.5
    return a.length + apart * float(np.clip(share, 0.1, 0.9))


def gauss_newton(residuals: Callable[[Tensor], Tensor], start: Tensor, steps: int, tolerance: float) -> Tensor:
    """The minimum of the squared norm of ``residuals`` near ``start`` (n,), by Levenberg and Marquardt's method.

    Roots of redescending losses flatten beyond what their derivatives tell, and steps come out half as long as they
    should be. So a step that gains more than predicted is doubled while the loss falls, which takes no derivatives.

    Args:
        residuals: (m,) of unknowns (n,), twice differentiable in reverse mode.
        steps: at most, each with one Jacobian.
        tolerance: relative decrease of the loss in one step at which the fit has converged.
    """

    def loss_at(at: Tensor) -> float:
        r = residuals(at)
        return float(r @ r)

    x, damping = start.detach().to(torch.float64), DAMPING
    with one_thread(), torch.no_grad():
        for _ in range(steps):
            r, jacobian = linearised(residuals, x)
            loss, gradient, normal = float(r @ r), jacobian.T @ r, jacobian.T @ jacobian
            scale = normal.diagonal().clamp(min=MIN_CURVATURE * float(normal.diagonal().max()))
            while damping < MAX_DAMPING:
                step = -torch.linalg.solve(normal + torch.diag(damping * scale), gradient)
                predicted, found = float(step @ (damping * scale * step - gradient)), loss_at(x + step)
                if predicted <= tolerance * loss / 8:
                    return x
                if loss - found > POOR_STEP * predicted:
                    break
                damping *= 8
            else:
                return x
            if loss - found > GOOD_STEP * predicted:
                damping = max(damping / 8, MIN_DAMPING)
            while loss - found > predicted and (longer := loss_at(x + 2 * step)) < found:
                step, found, predicted = 2 * step, longer, 2 * predicted
            x = x + step
            if loss - found <= tolerance * loss:
                break
    return x


def linearised(residuals: Callable[[Tensor], Tensor], at: Tensor) -> tuple[Tensor, Tensor]:
    """Residuals (m,) and their Jacobian (m, n) at unknowns (n,), for n far below m.

    A backward pass gives ``g = J^T u``, which is linear in u; the derivative of each g_k by u is a column of J. Forward
    mode gives the same numbers in twice the time, because it handles constants by a slow path.
    """
    with torch.enable_grad():
        x = at.detach().requires_grad_()
        r = residuals(x)
        u = torch.zeros_like(r, requires_grad=True)
        transposed = torch.autograd.grad(r, x, u, create_graph=True)[0]
        columns = [torch.autograd.grad(g, u, retain_graph=True)[0] for g in transposed]
    return r.detach(), torch.stack(columns, 1)


def simplex(
    loss: Callable[[FloatArray], float],
    corners: FloatArray,
    tolerance: float,
    bounds: Sequence[tuple[float, float]] | None = None,
    evaluations: int | None = None,
) -> tuple[FloatArray, float]:
    """The best unknowns (n,) found and their loss, by the simplex method of Nelder and Mead 1965.

    Args:
        loss: of unknowns (n,); needs no derivatives.
        corners: (n + 1, n) unknowns to start from, the first the best guess.
        tolerance: extent of the simplex in every unknown at which the search ends.
        bounds: of each unknown; steps end there.
        evaluations: of the loss, at most.
    """
    low, high = np.array(bounds).T if bounds is not None else (-np.inf, np.inf)
    points = [np.clip(corner, low, high) for corner in np.asarray(corners, np.float64)]
    values = [loss(point) for point in points]
    left = (evaluations or 200 * len(points)) - len(points)

    def tried(factor: float) -> tuple[float, FloatArray]:
        """Loss and place of the worst corner moved through the centre of the others, by ``factor`` of its distance."""
        nonlocal left
        left -= 1
        centre = np.mean(points[:-1], axis=0)
        point = np.clip(centre + factor * (centre - points[-1]), low, high)
        return loss(point), point

    while True:
        order = np.argsort(values, kind="stable")
        points, values = [points[i] for i in order], [values[i] for i in order]
        if left <= 0 or np.abs(np.array(points[1:]) - points[0]).max() <= tolerance:
            return points[0], values[0]
        best = tried(1.0)
        if best[0] < values[0]:
            best = min(best, tried(2.0), key=lambda trial: trial[0])
        elif best[0] >= values[-2]:
            outside = best[0] < values[-1]
            inner, limit = tried(0.5 if outside else -0.5), min(best[0], values[-1])
            if inner[0] > limit or (not outside and inner[0] == limit):
                points[1:] = [points[0] + 0.5 * (point - points[0]) for point in points[1:]]
                values[1:] = [loss(point) for point in points[1:]]
                left -= len(points) - 1
                continue
            best = inner
        values[-1], points[-1] = best


@contextmanager
def one_thread() -> Iterator[None]:
    """Have torch work on the calling thread alone: sums in one order, and no threads that wait for a few microseconds
    of work."""
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(before)
