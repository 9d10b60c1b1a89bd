"""Minimisers: known optima of known functions, bounds, outliers, and the same bytes again."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from torch import Tensor

from iris_addon.base.minimise import gauss_newton, lbfgs, one_thread, simplex


def rosenbrock(x: Tensor) -> Tensor:
    return rosenbrock_residuals(x).square().sum()


def rosenbrock_residuals(x: Tensor) -> Tensor:
    return torch.cat([10 * (x[1:] - x[:-1] ** 2), 1 - x[:-1]])


@pytest.mark.parametrize("n", [2, 10])
def test_the_valley_of_rosenbrock_is_followed_to_its_end(n: int) -> None:
    start = torch.linspace(-1.2, 1.0, n, dtype=torch.float64)
    assert lbfgs(rosenbrock, start, 300).numpy() == pytest.approx(np.ones(n), abs=1e-4)
    assert gauss_newton(rosenbrock_residuals, start, 100, 1e-12).numpy() == pytest.approx(np.ones(n), abs=1e-6)


def test_a_linear_problem_is_solved_in_closed_form() -> None:
    rng = torch.Generator().manual_seed(0)
    a, b = (torch.randn(size, generator=rng, dtype=torch.float64) for size in ((40, 5), (40,)))
    expected = torch.linalg.lstsq(a, b[:, None]).solution[:, 0].numpy()
    zero = torch.zeros(5, dtype=torch.float64)
    assert gauss_newton(lambda x: a @ x - b, zero, 30, 1e-14).numpy() == pytest.approx(expected, abs=1e-7)
    assert lbfgs(lambda x: (a @ x - b).square().sum(), zero, 100).numpy() == pytest.approx(expected, abs=1e-5)


def test_a_line_is_fitted_beside_outliers() -> None:
    rng = np.random.default_rng(0)
    x = np.linspace(0, 1, 200)
    y = 2 - 3 * x + rng.normal(0, 0.01, 200)
    y[:60] += rng.uniform(1, 5, 60)
    at, seen = torch.from_numpy(x), torch.from_numpy(y)

    def off(line: Tensor) -> Tensor:
        return (line[0] + line[1] * at - seen) / 0.03

    def root_of_cauchy(line: Tensor) -> Tensor:
        return torch.log1p(off(line).square() + 1e-12).sqrt()

    zero = torch.zeros(2, dtype=torch.float64)
    for found in (
        gauss_newton(root_of_cauchy, zero, 100, 1e-12),
        lbfgs(lambda line: torch.log1p(off(line).square()).sum(), zero, 200),
    ):
        assert found.numpy() == pytest.approx([2, -3], abs=0.01)
    assert np.abs(np.polyfit(x, y, 1) - [-3, 2]).max() > 0.5


def test_steps_are_as_long_as_a_redescending_norm_allows() -> None:
    """The root of Cauchy's loss has less curvature than its slope tells; steps in proportion to the slope are half as
    long as they should be, and forty of them come less far than ten."""
    generator = torch.Generator().manual_seed(0)
    at = torch.linspace(-1, 1, 400, dtype=torch.float64)
    seen = 3 * at + 1 + 0.5 * torch.randn(400, generator=generator, dtype=torch.float64)

    def root_of_cauchy(line: Tensor) -> Tensor:
        square = ((line[0] * at + line[1] - seen) / 0.05).square().clamp(min=1e-12)
        return torch.log1p(square).sqrt()

    zero = torch.zeros(2, dtype=torch.float64)
    best = gauss_newton(root_of_cauchy, zero, 200, 1e-14)
    assert gauss_newton(root_of_cauchy, zero, 10, 1e-14).numpy() == pytest.approx(best.numpy(), abs=1e-5)


def test_an_unknown_that_nothing_feels_stays() -> None:
    start = torch.tensor([3.0, 5.0], dtype=torch.float64)
    assert gauss_newton(lambda x: x[:1] - 1, start, 20, 1e-12).numpy() == pytest.approx([1, 5])
    assert lbfgs(lambda x: (x[0] - 1) ** 2, start, 20).numpy() == pytest.approx([1, 5])


def test_a_minimum_from_which_one_starts_is_kept() -> None:
    one = torch.ones(3, dtype=torch.float64)
    assert torch.equal(gauss_newton(rosenbrock_residuals, one, 20, 1e-9), one)
    assert torch.equal(lbfgs(rosenbrock, one, 20), one)


def test_a_minimum_is_found_without_derivatives() -> None:
    """Steps of a hundredth, as of rays that hit one cell or the next."""
    stairs = lambda x: float(np.round(100 * ((x[0] - 0.3) ** 2 + (x[1] + 0.2) ** 2)) / 100)  # noqa: E731
    found, loss = simplex(stairs, np.array([[1.0, 1.0], [0.5, 1.0], [1.0, 0.5]]), 1e-3)
    assert found == pytest.approx([0.3, -0.2], abs=0.1) and loss == 0
    found, _ = simplex(
        lambda x: float(rosenbrock(torch.from_numpy(x))), np.array([[-1.2, 1], [-1, 1], [-1.2, 1.2]]), 1e-6
    )
    assert found == pytest.approx([1, 1], abs=1e-5)
    root, _ = simplex(lambda x: abs(x[0] ** 2 - 2), np.array([[1.0], [1.5]]), 1e-9)
    assert root == pytest.approx([2**0.5])


def test_bounds_hold_and_may_be_the_answer() -> None:
    seen: list[np.ndarray] = []

    def loss(x: np.ndarray) -> float:
        seen.append(x)
        return float((x[0] + 1) ** 2 + (x[1] - 0.4) ** 2)

    found, _ = simplex(loss, np.array([[0.5, 0.5], [0.7, 0.5], [0.5, 0.7]]), 1e-4, [(0, 1), (0, 0.9)])
    assert found == pytest.approx([0, 0.4], abs=1e-3)
    assert np.min(seen) >= 0 and np.max(seen, axis=0)[1] <= 0.9


def test_no_more_is_evaluated_than_allowed() -> None:
    calls = []
    simplex(lambda x: calls.append(1) or float(x @ x), 5 + np.eye(4)[:, :3], 0.0, evaluations=40)
    assert 40 <= len(calls) <= 45


def test_the_same_start_gives_the_same_bytes_on_any_number_of_threads() -> None:
    generator = torch.Generator().manual_seed(0)
    a = torch.randn((20_000, 6), generator=generator, dtype=torch.float64)
    start = torch.zeros(6, dtype=torch.float64)
    found = []
    threads = torch.get_num_threads()
    for n in (1, 2, 1):
        torch.set_num_threads(n)
        found.append(lbfgs(lambda x: torch.log1p((a @ x - a[:, 0].exp()) ** 2).mean(), start, 30).numpy().tobytes())
    torch.set_num_threads(threads)
    assert len(set(found)) == 1


def test_threads_are_given_back_after_an_error() -> None:
    before = torch.get_num_threads()
    with pytest.raises(KeyError), one_thread():
        assert torch.get_num_threads() == 1
        raise KeyError
    assert torch.get_num_threads() == before
