"""Intervals: against other ways to compute them, and by simulation with known truth."""

from statistics import NormalDist

import numpy as np
import pytest

from assistax.evaluation.statistics import iqm, mean, probability_of_improvement, seed_ci, student_t


def test_student_t_is_that_of_the_tables():
    table = {1: 12.7062, 2: 4.3027, 3: 3.1824, 4: 2.7764, 9: 2.2622, 11: 2.2010, 30: 2.0423, 300: 1.9679}
    for freedom, quantile in table.items():
        np.testing.assert_allclose(student_t(float(freedom)), quantile, rtol=1e-4)
    assert student_t(3.0) < student_t(2.5) < student_t(2.0)


def test_mean_and_iqm_count_tasks_the_same():
    rng = np.random.default_rng(0)
    tasks = [rng.normal(size=4), rng.normal(size=4)]
    pooled = np.sort(np.concatenate(tasks))
    np.testing.assert_allclose(iqm(tasks), pooled[2:-2].mean())
    # Unequal numbers: as if each score were there so often that tasks are alike, then trimmed.
    tasks = [rng.normal(size=3), rng.normal(size=5)]
    pooled = np.sort(np.concatenate([np.repeat(tasks[0], 20), np.repeat(tasks[1], 12)]))
    np.testing.assert_allclose(iqm(tasks), pooled[30:-30].mean())
    np.testing.assert_allclose(mean(tasks), (tasks[0].mean() + tasks[1].mean()) / 2)
    batched = [np.stack([tasks[0], 2 * tasks[0]]), np.stack([tasks[1], 2 * tasks[1]])]
    np.testing.assert_allclose(iqm(batched), [iqm(tasks), 2 * iqm(tasks)])
    assert iqm([np.array([3.0])]) == 3.0


@pytest.mark.parametrize("n", [2, 3, 5, 12])
def test_the_interval_of_one_task_is_students(n):
    scores = np.random.default_rng(n).normal(size=n)
    half = student_t(n - 1.0) * scores.std(ddof=1) / np.sqrt(n)
    low, high = seed_ci([scores], resamples=50_000)
    np.testing.assert_allclose([low, high], [scores.mean() - half, scores.mean() + half], atol=0.02 * half)


def test_nothing_to_go_by_is_no_interval():
    assert seed_ci([np.array([1.0])]) is None
    assert seed_ci([np.array([1.0, 2.0]), np.array([1.0])]) is None
    assert seed_ci([np.array([1.0, 1.0, 1.0])]) is None
    assert seed_ci([np.array([1.0, 1.0]), np.array([1.0, 2.0])]) is not None


def covered(truth, intervals):
    return np.mean([low <= truth <= high for low, high in intervals])


@pytest.mark.parametrize("n", [2, 3, 5, 12])
def test_coverage_of_the_mean_over_seeds(n):
    """Seeds spread by 0.1 about 0.5; each is known only by 64 episodes that spread by 0.2."""
    rng = np.random.default_rng(n)
    skill = 0.5 + 0.1 * rng.normal(size=(1000, n, 1))
    episodes = skill + 0.2 * rng.normal(size=(1000, n, 64))
    rate = covered(0.5, [seed_ci([scores], resamples=500) for scores in episodes.mean(-1)])
    assert 0.93 < rate < 0.97
    pooled = episodes.reshape(1000, -1)  # what must not be done: each episode as if it were a seed
    half = 1.96 * pooled.std(1) / np.sqrt(64 * n)
    assert covered(0.5, zip(pooled.mean(1) - half, pooled.mean(1) + half, strict=True)) < 0.5


@pytest.mark.parametrize(("n", "spread", "expected"), [(3, 0.1, 0.76), (3, 0.01, 0.47), (12, 0.01, 0.93)])
def test_coverage_where_one_seed_in_five_fails_is_what_the_docstring_says(n, spread, expected):
    rng = np.random.default_rng(n)
    draws = (rng.random((600, n)) > 0.2) + spread * rng.normal(size=(600, n))
    rate = covered(0.8, [seed_ci([scores], resamples=200) for scores in draws])
    assert abs(rate - expected) < 0.06


@pytest.mark.parametrize("statistic", [mean, iqm])
@pytest.mark.parametrize("n", [2, 3, 12])
def test_coverage_of_an_aggregate(statistic, n):
    """Five tasks of different difficulty and spread."""
    level, spread = np.array([0.3, 0.5, 0.6, 0.8, 0.9]), np.array([0.05, 0.1, 0.2, 0.05, 0.15])
    normal = np.array([NormalDist().inv_cdf(q) for q in np.arange(0.0005, 1, 0.001)])
    population = level[:, None] + spread[:, None] * normal
    truth = statistic(list(population))
    draws = level[:, None] + spread[:, None] * np.random.default_rng(n).normal(size=(400, 5, n))
    assert 0.925 < covered(truth, [seed_ci(list(scores), statistic, resamples=150) for scores in draws]) < 0.98


def test_probability_of_improvement_by_counting():
    ours, theirs = [[3, 1], [5]], [[2, 0, 1], [5, 6]]
    wins = [(3 > 2) + (3 > 0) + (3 > 1) + (1 > 0) + 0.5, 0.5]
    value, ci = probability_of_improvement(ours, theirs)
    assert value == pytest.approx((wins[0] / 6 + wins[1] / 2) / 2) and ci is None
    value, (low, high) = probability_of_improvement([[3.0, 4.0, 5.0]], [[0.0, 1.0, 2.0]])
    assert value == 1.0 and low < 0.7 and high == 1.0  # three always better than three: far from certain
    back, (low_back, high_back) = probability_of_improvement([[0.0, 1.0, 2.0]], [[3.0, 4.0, 5.0]])
    assert (back, low_back, high_back) == (0.0, 0.0, pytest.approx(1 - low))


@pytest.mark.parametrize("tasks", [1, 5])
@pytest.mark.parametrize("shift", [0.0, 1.5, 3.0])
@pytest.mark.parametrize("n", [2, 3, 12])
def test_coverage_of_the_probability_of_improvement(tasks, shift, n):
    rng = np.random.default_rng(n)
    truth = NormalDist().cdf(shift / np.sqrt(2))
    draws = shift + rng.normal(size=(1000, tasks, n)), rng.normal(size=(1000, tasks, n))
    intervals = [probability_of_improvement(ours, theirs)[1] for ours, theirs in zip(*draws, strict=True)]
    assert covered(truth, intervals) > 0.92
    assert n < 12 or np.mean([high - low for low, high in intervals]) < 0.5  # and says something
