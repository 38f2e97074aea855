"""Means with 95 % intervals, over the episodes of one policy or over the seeds of an algorithm.

Episodes say how well one trained policy does; how well an algorithm does only its seeds say, so that episodes
of several seeds are never pooled. Scores of an algorithm are a list with one array [..., seeds] per task.
Aggregates after Agarwal et al. 2021, "Deep Reinforcement Learning at the Edge of the Statistical Precipice".
"""

from collections.abc import Callable, Sequence

import numpy as np

FEW_SEEDS = 10  # with fewer an interval relies on seeds being spread like a normal distribution
_MOST_DRAWN = 1 << 20  # numbers in memory while resampling
Interval = tuple[float, float]
Tasks = Sequence[np.ndarray]


# -- episodes ----------------------------------------------------------------------------------


def bootstrap_ci(values, resamples: int = 10_000, seed: int = 0) -> Interval | None:
    """95 % percentile-bootstrap interval of the mean of values [n]; None for one value."""
    values = np.asarray(values, np.float64)
    if len(values) < 2:
        return None
    rng = np.random.default_rng(seed)
    rows = max(1, _MOST_DRAWN // len(values))  # at a time, so that memory does not grow with the values
    sizes = [min(rows, resamples - done) for done in range(0, resamples, rows)]
    means = [values[rng.integers(len(values), size=(size, len(values)))].mean(1) for size in sizes]
    low, high = np.percentile(np.concatenate(means), [2.5, 97.5])
    return float(low), float(high)


def proportion_ci(successes: int, trials: int) -> Interval:
    """95 % Wilson score interval of a proportion: sound also at 0 and at 1."""
    z, p = 1.959964, successes / trials
    centre = p + z * z / (2 * trials)
    spread = z * np.sqrt(p * (1 - p) / trials + z * z / (4 * trials * trials))
    scale = 1 + z * z / trials
    return max(0.0, float((centre - spread) / scale)), min(1.0, float((centre + spread) / scale))


# -- seeds -------------------------------------------------------------------------------------


def mean(tasks: Tasks) -> np.ndarray:
    """Mean over seeds, then over tasks, which count the same however many seeds they have."""
    return np.mean(np.broadcast_arrays(*(scores.mean(-1) for scores in tasks)), 0)


def iqm(tasks: Tasks) -> np.ndarray:
    """Interquartile mean: of the middle half of all scores, those at its edges in part.

    Tasks count the same however many seeds they have. With four scores or a multiple, and as many for each task,
    this is the mean without the lowest and the highest quarter.
    """
    batch = np.broadcast_shapes(*(scores.shape[:-1] for scores in tasks))
    x = np.concatenate([np.broadcast_to(scores, (*batch, scores.shape[-1])) for scores in tasks], -1)
    weights = np.concatenate([np.full(scores.shape[-1], 1 / scores.shape[-1]) for scores in tasks]) / len(tasks)
    order = np.argsort(x, -1)
    upto = np.cumsum(weights[order], -1)
    inside = np.clip(upto, 0.25, 0.75) - np.clip(upto - weights[order], 0.25, 0.75)
    return 2 * np.sum(inside * np.take_along_axis(x, order, -1), -1)


def seed_ci(
    tasks: Tasks, statistic: Callable[[Tasks], np.ndarray] = mean, resamples: int = 1000, seed: int = 0
) -> Interval | None:
    """95 % interval of `mean` or `iqm` for new seeds of the same tasks: a stratified bootstrap of seeds.

    Seeds are resampled within each task; the spread this gives, corrected for what a bootstrap of n seeds lacks,
    sqrt(n / (n - 1)), is the standard error, and the interval is Student's t of it with Welch's degrees of freedom.
    Percentiles of the same bootstrap, as Agarwal et al. take them for 10 seeds and more, are much too narrow for few:
    on normal scores of one task they cover 53 %, 76 %, 83 % and 92 % for 2, 3, 5 and 12 seeds, this 94 to 95 %. With
    exponential scores this covers 87 to 90 % up to 12 seeds. If one seed in five fails, at 0 where others have 1, it
    covers 76, 72 and 93 % for 3, 5 and 12 seeds that are spread by 0.1 about that, and 47, 64 and 93 % if by 0.01 only:
    half of all threes have no failure among them, and no interval knows a tail that it has not seen.

    Args:
      tasks: per task the scores [seeds].

    Returns:
      (low, high), or None where there is nothing to go by: a task with one seed, or no spread at all.
    """
    tasks = [np.asarray(scores, np.float64) for scores in tasks]
    if min(scores.size for scores in tasks) < 2:
        return None
    rng = np.random.default_rng(seed)
    variances = []
    for i, scores in enumerate(tasks):
        resampled = list(tasks)
        resampled[i] = scores[rng.integers(scores.size, size=(resamples, scores.size))]
        variances.append(statistic(resampled).var() * scores.size / (scores.size - 1))
    if sum(variances) < 1e-24:
        return None
    # An aggregate of tasks knows its spread better than each task does: Welch and Satterthwaite.
    freedom = sum(variances) ** 2 / sum(v * v / (x.size - 1) for v, x in zip(variances, tasks, strict=True))
    centre, half = float(statistic(tasks)), student_t(freedom) * float(np.sqrt(sum(variances)))
    return centre - half, centre + half


def student_t(freedom: float) -> float:
    """97.5 % quantile of Student's t with `freedom` degrees of freedom."""
    from scipy.special import stdtrit  # not before: it takes half a second, which a training would wait for

    return float(stdtrit(freedom, 0.975))


def probability_of_improvement(ours: Tasks, theirs: Tasks) -> tuple[float, Interval | None]:
    """How probable it is that a seed of one algorithm beats one of another on a task drawn at random; ties count half.

    A bootstrap collapses to a point where one algorithm always wins (three seeds each, true value 0.98: it covers
    10 %). The 95 % interval is instead all values p from which the estimate is less than Student's t standard errors
    away, with the variance of the Mann-Whitney statistic at p after Newcombe 2006 ("Confidence intervals for an effect
    size measure based on the Mann-Whitney statistic", part 2, method 5), as if p were that of every task: too wide
    where tasks differ. It covers 93 % and more with as many seeds for both, 85 % with 3 against 12 seeds if the 3 are
    spread three times as far.

    Args:
      ours, theirs: per task the scores [seeds].

    Returns:
      the probability, and its interval, or None if either has but one seed of some task.
    """
    pairs = [(np.asarray(x)[:, None], np.asarray(y)[None, :]) for x, y in zip(ours, theirs, strict=True)]
    estimate = float(np.mean([np.mean((x > y) + 0.5 * (x == y)) for x, y in pairs]))
    sizes = [(x.size, y.size) for x, y in pairs]
    if min(map(min, sizes)) < 2:
        return estimate, None
    p = np.linspace(0.0, 1.0, 2001)
    spread = (1 - p) / (2 - p) + p / (1 + p)
    variance = sum(p * (1 - p) * (1 + ((m + n) / 2 - 1) * spread) / (m * n) for m, n in sizes) / len(sizes) ** 2
    near = p[np.abs(p - estimate) <= student_t(float(sum(m + n - 2 for m, n in sizes))) * np.sqrt(variance) + 1e-9]
    return estimate, (float(near[0]), float(near[-1]))


# -- seeds and partners ------------------------------------------------------------------------


def crossed_ci(scores: np.ndarray) -> Interval | None:
    """95 % interval of the mean for new seeds and new partners, of scores [seeds, partners] that cross both.

    Every seed's robot has met every partner: the mean's variance is that of seeds, of partners and of what is left of
    each pair, estimated without bias from the mean squares of a two-way layout with random effects (Searle, Casella
    and McCulloch 1992, chapter 4), and the interval is Student's t of it with Satterthwaite's degrees of freedom. With
    normal effects it covers 92 to 98 % at 3 seeds and 10 partners and 94 to 98 % at 10 and 50, whether seeds, partners
    or pairs differ most, but 88 to 91 % at 2 seeds that do. With one seed it is an interval for new partners of that
    robot, with one partner for new seeds.

    None where there is nothing to go by: one number, or no spread at all.
    """
    x = np.asarray(scores, np.float64)
    if x.size < 2 or np.ptp(x) == 0:
        return None
    if min(x.shape) == 1:
        flat = x.ravel()
        error, freedom = flat.std(ddof=1) / np.sqrt(flat.size), flat.size - 1
    else:
        squares, degrees = _mean_squares(x)
        total = squares[0] + squares[1] - squares[2]
        freedom = total**2 / (squares**2 / degrees).sum()
        if squares[:2].max() <= squares[2]:  # both components are none, and all numbers of one kind
            total, freedom = x.var(ddof=1), x.size - 1
        elif squares[:2].min() <= squares[2]:  # one of the two is
            larger = squares[:2].argmax()
            total, freedom = squares[larger], degrees[larger]
        error = np.sqrt(total / x.size)
    reach = student_t(freedom) * error
    return float(x.mean() - reach), float(x.mean() + reach)


def gap_ci(known: np.ndarray, strange: np.ndarray) -> Interval | None:
    """95 % interval of mean(known) - mean(strange) for new seeds and new partners of either kind.

    Both are scores [seeds, partners], as in `crossed_ci`, of the same seeds' robots beside partners of two kinds. The
    variance is that of the seeds' own gaps, which holds what is left of each pair, too, and that of either kind's
    partners; Student's t has Satterthwaite's degrees of freedom. With one seed it is Welch's interval for new partners
    of that robot. With normal effects it covers 93 to 98 % at 3 seeds with 14 and 5 partners, and 90 to 98 % at 2.

    None where there is nothing to go by: of one seed one number of either kind, or no spread at all. With several
    seeds and one partner of a kind it is an interval for new seeds beside that partner.
    """
    a, b = np.asarray(known, np.float64), np.asarray(strange, np.float64)
    seeds, kinds = len(a), (a, b)
    if max(np.ptp(a), np.ptp(b)) == 0 or (seeds == 1 and min(a.size, b.size) < 2):
        return None
    terms = []  # of the variance, each with its degrees of freedom
    if seeds > 1:
        terms.append((np.var(a.mean(1) - b.mean(1), ddof=1) / seeds, seeds - 1))
    for x in kinds:
        if x.shape[1] < 2:
            continue
        if seeds == 1:
            terms.append((x.var(ddof=1) / x.size, x.size - 1))
            continue
        squares, degrees = _mean_squares(x)
        if squares[1] > squares[2]:
            terms += [(squares[1] / x.size, degrees[1]), (-squares[2] / x.size, degrees[2])]
    return _around(float(a.mean() - b.mean()), terms)


def paired_ci(ours: np.ndarray, theirs: np.ndarray) -> Interval | None:
    """95 % interval of mean(ours) - mean(theirs) for new seeds of both and new partners.

    Both are scores [seeds, partners], as in `crossed_ci`, of other robots beside the same partners, so that what makes
    a partner hard for both falls out. The variance is that of either kind of seeds and that of the partners'
    differences, less what the seeds' have in it already; Student's t has Satterthwaite's degrees of freedom. With one
    seed of both it is Student's paired interval for new partners of these two robots. With normal effects it covers
    94 to 100 % at 3 and 2 seeds with 8 partners, 92 to 99 % at 2 and 1.

    None where there is nothing to go by: one seed of both and one partner, or no spread at all.
    """
    a, b = np.asarray(ours, np.float64), np.asarray(theirs, np.float64)
    partners, terms = a.shape[1], []  # of the variance, each with its degrees of freedom
    if partners > 1:
        terms.append(((a.mean(0) - b.mean(0)).var(ddof=1) / partners, partners - 1))
    for x in (a, b):
        if len(x) > 1:
            terms.append((x.mean(1).var(ddof=1) / len(x), len(x) - 1))
            if partners > 1:
                squares, degrees = _mean_squares(x)
                terms.append((-squares[2] / x.size, degrees[2]))
    # What is taken away may be more than there is: the largest part is left.
    return _around(float(a.mean() - b.mean()), terms, max((term for term, _ in terms), default=0.0))


def _around(centre: float, terms: Sequence[tuple[float, float]], least: float = 0.0) -> Interval | None:
    """Student's interval with the sum of these (variance, degrees of freedom), or `least`; None without any spread."""
    variance = max(sum(term for term, _ in terms), least)
    if variance <= 0.0:
        return None
    freedom = variance**2 / sum(term**2 / degree for term, degree in terms)
    # Below the least of its parts' it falls only where parts are taken from each other.
    reach = student_t(max(freedom, min(degree for _, degree in terms))) * float(np.sqrt(variance))
    return centre - reach, centre + reach


def _mean_squares(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Of rows, columns and what is left of each number of x [rows, columns], two or more of each; and their degrees."""
    rows, columns = x.shape
    by_row, by_column, mean = x.mean(1), x.mean(0), x.mean()
    left = x - by_row[:, None] - by_column + mean
    degrees = np.array([rows - 1, columns - 1, (rows - 1) * (columns - 1)])
    sums = [columns * ((by_row - mean) ** 2).sum(), rows * ((by_column - mean) ** 2).sum(), (left**2).sum()]
    return np.array(sums) / degrees, degrees
