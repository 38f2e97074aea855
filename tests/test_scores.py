"""Scores of ad-hoc teamwork, and their intervals, against hand-worked numbers and simulations."""

import numpy as np
import pytest
from scipy.stats import ttest_ind, ttest_rel

from assistax.evaluation.statistics import crossed_ci, gap_ci, paired_ci, proportion_ci
from assistax.teamwork.adhoc import only
from assistax.teamwork.scores import FEWEST, Scale, by_pair, difference, gap, scales, summarize


def test_scores_are_between_who_knows_nobody_and_who_knows_them():
    returns = {"still": [1.0, 5.0, 2.0], "random": [0.0, 1.0, 1.0], "expert": [3.0, 2.0, 1.0]}
    references = {name: {"return": np.array(x)[:, None]} for name, x in returns.items()}
    references |= {
        "own": {"return": np.array([[5.0], [5.1], [4.0]])},
        "best": {"return": np.array([[7.0], [5.0], [3.0]])},
        "considerate": {"return": np.array([[9.0], [9.0], [9.0]])},  # no end of the scale
    }
    scale = Scale.of(references)
    assert scale.zero.tolist() == [3, 5, 2] and scale.one.tolist() == [7, 5.1, 4]
    assert scale.scored.tolist() == [True, False, True]  # the second knows nobody and is as good
    robots = np.array([[5.0, 5.0, 2.0], [7.0, 5.0, 4.0]])
    np.testing.assert_array_equal(scale(robots), [[0.5, np.nan, 0.0], [1.0, np.nan, 1.0]])
    np.testing.assert_allclose(scale.regret(robots), [[2.0, 0.1, 2.0], [0.0, 0.1, 0.0]])
    assert not Scale.of({k: references[k] for k in returns}).scored.any()

    # Six such partners in a row: enough of them for a score.
    pairs = [{"return": np.tile(robot, 2)[:, None]} for robot in robots]
    few = summarize(by_pair([{"return": robot[:, None]} for robot in robots], {"return": scale}))
    more = Scale(np.tile(scale.zero, 3), np.tile(scale.one, 3))
    found = summarize(by_pair([{"return": np.tile(robot, 3)[:, None]} for robot in robots], {"return": more}))
    assert found["score"]["by_pair"] == [[0.5, None, 0.0] * 3, [1.0, None, 1.0] * 3]
    assert found["score"]["mean"] == 0.625 and found["regret"]["mean"] == pytest.approx(0.7)
    assert more.scored.sum() >= FEWEST > scale.scored.sum() and "score" not in few and "regret" in few
    assert "score" not in by_pair(pairs, {"return": Scale(np.tile(scale.zero, 2), np.tile(scale.one, 2))})


def test_intervals_of_rates_are_of_rates():
    robots = [{"success": np.array([[1.0], [0.0], [1.0]]), "return": np.array([[1.0], [0.0], [1.0]])}]
    found = summarize(by_pair(robots))
    assert found["success"]["ci"] == (0.0, 1.0)
    assert found["return"]["ci"][0] < 0.0 and found["return"]["ci"][1] > 1.0
    known, strange = ({"success": np.array(x), "return": np.array(x)} for x in ([[1.0, 0.9, 0.4]], [[0.0, 0.6]]))
    found = gap(known, strange)
    assert found["success"]["ci"] == (max(-1.0, found["return"]["ci"][0]), 1.0) and found["return"]["ci"][1] > 1.0


def test_the_worst_partner_has_least_of_what_helps_and_most_of_what_harms():
    """Two partners, an episode each; the first is better off in everything."""
    better = {"return": 3.0, "task_return": 2.0, "preference_return": 1.0, "success": 1.0, "safe_success": 1.0}
    better |= {"peak_force": 5.0, "seconds_above_comfort": 0.0, "clamping": 0.0, "impact": 0.0}
    worse = {"return": 0.0, "task_return": 0.5, "preference_return": -0.5, "success": 0.0, "safe_success": 0.0}
    worse |= {"peak_force": 90.0, "seconds_above_comfort": 2.0, "clamping": 1.0, "impact": 1.0}
    found = summarize(by_pair([{name: np.array([[better[name]], [worse[name]]]) for name in better}]))
    assert {name: found[name]["worst"] for name in worse} == worse
    assert found["gated_preference_return"]["worst"] == found["gated_return"]["worst"] - 0.5 == 0.0
    assert found["clamping"]["ci"] == (0.0, 1.0) and found["peak_force"]["ci"][0] == 0.0


def test_the_worst_tenth_is_of_each_seed():
    """Two robots, each of whom fails another of two partners: with both of them somebody is not helped."""
    pairs = {"success": np.array([[1.0, 0.0], [0.0, 1.0]]), "clamping": np.array([[1.0, 0.0], [0.0, 1.0]])}
    found = summarize(pairs)
    assert found["success"]["worst"] == 0.0 and found["clamping"]["worst"] == 1.0


def test_an_interval_of_what_always_or_never_happens_is_wilsons_for_new_partners():
    found = summarize({name: np.full((3, 5), share) for name, share in (("success", 1.0), ("impact", 0.0))})
    assert found["success"]["ci"] == pytest.approx(proportion_ci(5, 5)) and found["success"]["ci"][0] < 0.6
    assert found["impact"]["ci"] == pytest.approx(proportion_ci(0, 5)) and found["impact"]["ci"][1] > 0.4
    assert summarize({"return": np.ones((3, 5))})["return"]["ci"] is None


def test_regret_does_not_count_that_strangers_are_easier_to_help():
    """A robot as far from the best as ever, with people of whom the best reaches 10 and 20."""

    def side(best):
        returns = {name: {"return": np.zeros((4, 1))} for name in ("still", "random", "expert")}
        made = scales(returns | {"own": {"return": np.full((4, 1), best)}})
        return by_pair([{"return": np.array([[best - x] for x in (3.0, 1.0, 2.0, 2.0)])}], made)

    found = gap(side(10.0), side(20.0))
    assert found["return"]["mean"] == -10.0 and found["regret"]["mean"] == 0.0
    assert found["regret"]["ci"][0] < 0.0 < found["regret"]["ci"][1]


def test_preferences_count_only_with_success():
    one = {"return": np.ones((2, 2)), "success": np.array([[1.0, 0.0], [1.0, 1.0]])}
    one["preference_return"] = np.array([[10.0, 100.0], [20.0, 40.0]])
    found = by_pair([one])
    assert summarize(found)["gated_preference_return"]["by_pair"] == [[5.0, 30.0]]
    assert gap(found, by_pair([one | {"return": np.zeros((2, 2))}]))["return"] == {"mean": 1.0, "ci": None}


def test_a_score_of_its_own_counts_preferences_only_with_success():
    """Two episodes, 100 of task return in each that succeeds; the robot pleases and does not help, whoever it is."""

    def robot(success, pleasing):
        success, pleasing = np.array([success] * FEWEST, float), np.array([pleasing] * FEWEST, float)
        return {"return": 100.0 * success + pleasing, "success": success, "preference_return": pleasing}

    nobody = {name: robot([0, 0], [0, 0]) for name in ("still", "random", "expert")}
    scale = scales(nobody | {"own": robot([1, 1], [20, 20])})
    found = summarize(by_pair([robot([0, 1], [150, 10])], scale))
    assert found["score"]["mean"] == pytest.approx(130 / 120)
    assert found["gated_score"]["mean"] == pytest.approx(55 / 120)
    assert list(scales({name: {"return": np.ones((1, 2))} for name in (*nobody, "own")})) == ["return"]


def test_who_does_not_know_a_partner_is_no_reference_for_it():
    nobody = {name: {"return": np.array([[1.0], [1.0], [1.0]])} for name in ("still", "random", "expert")}
    best = only(np.array([True, False, False]), {"return": np.array([[3.0], [9.0], [9.0]])})
    own = only(np.array([False, True, False]), {"return": np.array([[9.0], [2.0], [9.0]])})
    scale = Scale.of(nobody | {"best": best, "own": own})
    np.testing.assert_array_equal(scale.one, [3.0, 2.0, np.nan])
    assert scale.scored.tolist() == [True, True, False]
    found = summarize(by_pair([best]))["return"]
    assert found["by_pair"] == [[3.0, None, None]] and found["mean"] == 3.0


@pytest.mark.parametrize("shape", [(3, 10), (10, 50)])
@pytest.mark.parametrize("spread", [(1.0, 1.0, 1.0), (1.0, 0.3, 0.3), (0.3, 1.0, 0.3), (0.1, 0.1, 1.0)])
def test_coverage_over_seeds_and_partners(shape, spread):
    rng, (seeds, partners) = np.random.default_rng(0), shape
    covered, trials = 0, 600
    for _ in range(trials):
        effects = rng.normal(size=(seeds, 1)), rng.normal(size=(1, partners)), rng.normal(size=shape)
        low, high = crossed_ci(sum(a * x for a, x in zip(spread, effects, strict=True)))
        covered += low <= 0 <= high
    assert 0.9 <= covered / trials <= 0.995


@pytest.mark.parametrize("shape", [(3, 14, 5), (10, 50, 20)])
@pytest.mark.parametrize(
    "spread", [(1.0, 1.0, 1.0, 0.5), (0.3, 1.0, 0.3, 0.3), (0.1, 0.1, 1.0, 0.1), (0.3, 0.3, 0.3, 1.0)]
)
def test_coverage_of_gaps_over_seeds_and_both_kinds_of_partners(shape, spread):
    """Seeds are better or worse with everybody, and with one kind; so are partners and pairs."""
    rng, (seeds, *partners) = np.random.default_rng(0), shape
    covered, trials = 0, 600
    for _ in range(trials):
        better, kinds = spread[0] * rng.normal(size=(seeds, 1)), []
        for number in partners:
            effects = rng.normal(size=(1, number)), rng.normal(size=(seeds, number)), rng.normal(size=(seeds, 1))
            kinds.append(better + sum(a * x for a, x in zip(spread[1:], effects, strict=True)))
        low, high = gap_ci(*kinds)
        covered += low <= 0 <= high
    assert 0.92 <= covered / trials <= 0.99


def test_a_gap_of_one_seed_is_welchs():
    a, b = np.array([[1.0, 2.0, 3.0, 6.0]]), np.array([[0.0, 1.0]])
    welch = ttest_ind(a[0], b[0], equal_var=False).confidence_interval()
    np.testing.assert_allclose(gap_ci(a, b), (welch.low, welch.high), rtol=1e-3)
    assert gap_ci(np.ones((3, 4)), np.zeros((3, 2))) is None and gap_ci(np.ones((1, 1)), np.zeros((1, 1))) is None


@pytest.mark.parametrize("shape", [(3, 2, 8), (5, 5, 30), (3, 3, 16)])
@pytest.mark.parametrize("spread", [(1.0, 1.0, 1.0), (0.1, 1.0, 0.3), (0.1, 0.1, 1.0), (0.3, 0.0, 0.3)])
def test_coverage_of_differences_beside_the_same_partners(shape, spread):
    """Partners are harder or easier for both, and for one; seeds and pairs differ."""
    rng, (*seeds, partners) = np.random.default_rng(0), shape
    covered, trials = 0, 600
    for _ in range(trials):
        hard, kinds = 3.0 * rng.normal(size=(1, partners)), []
        for number in seeds:
            effects = rng.normal(size=(number, 1)), rng.normal(size=(1, partners)), rng.normal(size=(number, partners))
            kinds.append(hard + sum(a * x for a, x in zip(spread, effects, strict=True)))
        low, high = paired_ci(*kinds)
        covered += low <= 0 <= high
    assert 0.92 <= covered / trials <= 1.0


def test_a_difference_of_one_seed_each_is_students_paired():
    a, b = np.array([[1.0, 2.0, 3.0, 7.0]]), np.array([[0.0, 2.0, 1.0, 4.0]])
    paired = ttest_rel(a[0], b[0]).confidence_interval()
    np.testing.assert_allclose(paired_ci(a, b), (paired.low, paired.high), rtol=1e-5)
    assert paired_ci(np.ones((3, 4)), np.zeros((3, 4))) is None and paired_ci(a[:, :1], b[:, :1]) is None
    unpaired = gap_ci(a, b)
    assert paired.high - paired.low < unpaired[1] - unpaired[0]
    found = difference({"success": np.array([[1.0, 1.0, np.nan]])}, {"success": np.array([[0.0, 1.0, 1.0]])})
    assert found["success"]["mean"] == 0.5 and found["success"]["ci"] == (-1.0, 1.0)


def test_no_interval_hides_what_cannot_be_known():
    """Two robots, two partners, each good with another one; and one robot with a single stranger."""
    low, high = crossed_ci(np.array([[1.0, 0.0], [0.0, 1.0]]))
    assert low < 0.2 and high > 0.8
    assert gap_ci(np.array([[1.0, 0.5, 0.8]]), np.array([[0.2]])) is None


def test_an_interval_of_one_seed_is_over_partners():
    x = np.array([[1.0, 2.0, 3.0, 6.0]])
    low, high = crossed_ci(x)
    error = x.std(ddof=1) / 2
    np.testing.assert_allclose((low, high), (3 - 3.182446 * error, 3 + 3.182446 * error), rtol=1e-5)
    assert crossed_ci(np.ones((3, 4))) is None and crossed_ci(np.ones((1, 1))) is None


def test_intervals_of_differences_are_no_wider_than_they_must_be():
    """Of many seeds and partners, where the true spread is known: what both share falls out once."""
    rng, shape, (seeds, partners, both) = np.random.default_rng(0), (20, 20, 40), (0.1, 0.1, 1.0)
    one, other, met = shape
    true = np.sqrt((seeds**2 + both**2 / met) * (1 / one + 1 / other) + 2.0 * partners**2 / met)
    widths = []
    for _ in range(200):
        kinds = [
            seeds * rng.normal(size=(n, 1)) + partners * rng.normal(size=(1, met)) + both * rng.normal(size=(n, met))
            for n in (one, other)
        ]
        low, high = paired_ci(*kinds)
        widths.append(high - low)
    assert 0.9 < np.mean(widths) / (2.0 * 1.96 * true) < 1.2
