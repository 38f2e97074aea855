"""Ad-hoc teamwork: who meets whom, and what is reported of it."""

import dataclasses
import json
from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from commands import assistax as assistax_command
from stored import stored_run

import assistax
from assistax.errors import UsageError
from assistax.evaluation.playing import Evaluator
from assistax.human import Person
from assistax.learning.ppo import PPO, PPOConfig
from assistax.policies import Player, Still, scripted_policy
from assistax.teamwork.adaptation import Series, about, probe, slope, summarize_series
from assistax.teamwork.adhoc import Meeting, draws
from assistax.teamwork.gather import selves_of
from assistax.teamwork.report import meeting_env, picture, report
from assistax.teamwork.scores import SCORES, Scale
from assistax.teamwork.strangers import knows
from assistax.teamwork.validity import judge, with_robots
from assistax.training import splits
from assistax.training.configuration import configure
from assistax.training.population import Population, self_of
from assistax.training.run import Run

CONFIG = PPOConfig(num_steps=4, num_minibatches=1, hidden=(8, 8), initial_log_std=-1.0)
SETTINGS = {"ppo.num_steps": 4, "ppo.num_minibatches": 1, "ppo.hidden": (8, 8), "env.human.preference": "default"}
PEOPLE = ("none", "tremor", "weakness", "limited_range", "strength=0.5")


@pytest.fixture(scope="module")
def population():
    """Five untrained members with preferences."""
    return untrained()


def untrained(clock=None):
    """Five untrained teams with preferences, whose robots see such a clock."""
    env = assistax.make("scratch-v3", engine="mujoco", clock=clock, human={"preference": "default"})
    trainer = PPO(env, CONFIG, 2, 1)
    init, made = jax.jit(trainer.init), []
    for seed, words in enumerate(PEOPLE):
        params = trainer.policy_params(init(jax.random.key(seed)))
        row = {"task": env.name, "algorithm": "ippo", "seed": seed, "steps": 64, "robot": True}
        row["person"] = dataclasses.asdict(Person(words, "default"))
        made.append((row, {agent: Player.of(trainer.policy(False), params[agent]) for agent in params}))
    return Population.of_teams(made)


@pytest.fixture(scope="module")
def two_kinds():
    """Two untrained members of larger networks than `population` has."""
    env = assistax.make("scratch-v3", engine="mujoco", human={"preference": "default"})
    trainer = PPO(env, dataclasses.replace(CONFIG, hidden=(16,)), 2, 1)
    init, made = jax.jit(trainer.init), []
    for seed in (7, 8):
        params = trainer.policy_params(init(jax.random.key(seed)))
        row = {"task": env.name, "algorithm": "ippo", "seed": seed, "steps": 64, "robot": True}
        row["person"] = dataclasses.asdict(Person("tremor", "default"))
        made.append((row, {agent: Player.of(trainer.policy(False), params[agent]) for agent in params}))
    return Population.of_teams(made)


def meeting(population, episodes=2):
    env = assistax.make("scratch-v3", engine="mujoco", episode_length=30, human={"people": population.people})
    return Meeting(env, population, episodes)


def test_the_order_of_partners_changes_nothing_and_twice_is_the_same(population):
    robot = {"policy": "expert"}
    order = population.ids[::-1]
    here, there = meeting(population), meeting(population.select(order))
    first, again, turned = (
        one(Player(scripted_policy(robot["policy"], one.env, "robot"))) for one in (here, here, there)
    )
    for name in first:
        assert first[name].shape == (5, 2)
        np.testing.assert_array_equal(first[name], again[name])
        np.testing.assert_array_equal(first[name], turned[name][::-1])
    assert len(np.unique(first["return"])) == 10


def test_no_two_episodes_draw_the_same_and_a_partner_always_does(population):
    """Or a mean over partners would be one over a few itches, whatever their number."""
    drawn = draws(population, 16).reshape(5, 16)
    assert len(np.unique(drawn)) == 80
    np.testing.assert_array_equal(draws(population.select(population.ids[3:]), 16).reshape(2, 16), drawn[3:])


def test_all_episodes_of_a_meeting_and_of_a_series_draw_differently(population, monkeypatch):
    one, keys = meeting(population, 3), []
    robot = Player(scripted_policy("still", one.env, "robot"))

    def play(_, given, *rest):
        keys.append(jax.random.key_data(given))
        raise StopIteration

    monkeypatch.setattr(one._evaluator, "_play", play)
    series = Series(one.env, population, 2, 3)
    monkeypatch.setattr(series, "_play", play)
    for each in (one, series):
        with pytest.raises(StopIteration):
            each(robot)
    assert [len(np.unique(np.asarray(drawn), axis=0)) for drawn in keys] == [15, 15]


def test_episodes_with_the_same_draws_are_the_same(population):
    env = meeting(population).env
    team = {"robot": Player(scripted_policy("expert", env, "robot")), "human": population.partner("human", env=env)}
    found = Evaluator(env, 4)(team, people=[0, 0, 0, 1], draws=[7, 8, 7, 7])["metrics"]["return"]
    assert found[0] == found[2] and len(np.unique(found)) == 3


def test_a_reset_can_name_the_person(population):
    env = meeting(population).env
    _, states = jax.vmap(env.reset, (0, None, 0))(jax.random.split(jax.random.key(0), 5), 0, jnp.arange(5))
    assert states.person.index.tolist() == [0, 1, 2, 3, 4]
    strengths = [float(dataclasses.asdict(p)["disability"] == "strength=0.5") for p in population.people]
    np.testing.assert_allclose(states.person.disability.strength[4], 0.5)
    assert strengths == [0, 0, 0, 0, 1]


def test_the_picture_needs_no_score(tmp_path):
    """Nobody of one part may be scored."""
    one = {"mean": 1.0, "ci": (0.3, 1.0 - 1e-15), "by_pair": [[1.0, 1.0]]}  # as Wilson's of what always happens
    methods = {"train": {"br": {"return": one, "score": one}}, "test": {"br": {"return": one}}}
    found = {"task": "feeding-v3"} | {part: {"methods": made} for part, made in methods.items()}
    picture(found, tmp_path / "table.png")
    assert (tmp_path / "table.png").stat().st_size > 5000


@pytest.fixture(scope="module")
def robots(population, tmp_path_factory):
    """A run whose robot trained with the population's training part, and one that knows the body, too."""
    root = tmp_path_factory.mktemp("robots")
    population.save(root / "pop")
    splits.save(splits.path_of(root / "pop", "random"), splits.split(population))
    made = {}
    for name, settings in (
        ("br", {}),
        ("oracle", {"env.human.visibility": "oracle", "env.human.weights": (2.0, 1.0, 1.0)}),
    ):
        partners = (f"human={root}/pop:random/train",)
        config = configure(
            "scratch", {k: v for k, v in SETTINGS.items() if "human" not in k} | settings, partners=partners
        )
        config = dataclasses.replace(config, num_seeds=2)
        config = dataclasses.replace(config, env=dataclasses.replace(config.env, episode_length=20))
        made[name] = stored_run(root / name, config)
    return root, made


def parts_of(root, *names):
    return {part: splits.named(f"{root}/pop:random/{part}")[1] for part in names}


def test_robots_that_have_met_a_held_out_partner_are_refused(robots, tmp_path):
    """As a member, however called, as an earlier self, as a run of its own, beside which it learned, or by name."""
    root, made = robots
    parts = parts_of(root, "train", "test")
    met = parts["train"].ids[0]
    for held_out in ("test", "val"):
        with pytest.raises(UsageError, match=f"was trained with {met[:12]}, a partner of the {held_out}"):
            report({"br": [made["br"]]}, {"train": parts["train"], held_out: parts["train"]}, episodes=1)
    assert not any(knows(made["br"], parts["test"]))

    rows = [row | {"id": f"earlier {row['id']}", "fraction": 0.333} for row in parts["train"].rows]
    earlier = dataclasses.replace(parts["train"], rows=tuple(rows))
    assert all(knows(made["br"], earlier))

    renamed = [row | {"id": f"again {row['id']}", "seed": 77} for row in parts["train"].rows]
    assert all(knows(made["br"], dataclasses.replace(parts["train"], rows=tuple(renamed))))

    learned = stored_run(tmp_path / "learned", configure("scratch", SETTINGS))
    row = {"task": "scratch-v3", "algorithm": "ippo", "seed": 0, "steps": 64, "robot": True}
    row["person"] = dataclasses.asdict(Person("none", "default"))
    member = Population.of_teams([(row, learned.teams(deterministic=False)[0])])
    robot = stored_run(tmp_path / "robot", configure("scratch", SETTINGS, partners=(f"human={tmp_path}/learned",)))
    other = stored_run(tmp_path / "other", configure("scratch", SETTINGS), seed=1)
    assert [knows(run, member) for run in (learned, robot, other)] == [[True], [True], [False]]

    people = Population.scripted("scratch-v3", [Person("none", "default")], ("shy", "follows"))
    went_on = Population.of_teams([(row | {"taught": "offer"}, learned.teams(deterministic=False)[0])])
    beside = stored_run(tmp_path / "beside", configure("scratch", SETTINGS, partners=(f"human={tmp_path}/other",)))
    another = stored_run(tmp_path / "another", configure("scratch", SETTINGS, seed=5), seed=1)
    assert [knows(run, went_on) for run in (other, beside, another)] == [[True], [True], [False]]

    shy = stored_run(tmp_path / "shy", configure("scratch", SETTINGS, partners=("human=shy",)))
    assert knows(shy, people) == [True, False] and knows(made["br"], people) == [False, False]

    ways = ("offers", "offers_third_way", "shy")
    people = Population.scripted("tooth_brushing-v2", [Person("none", "default")], ways)  # of which there are two
    offered = stored_run(tmp_path / "offered", configure("tooth_brushing", SETTINGS, partners=("human=offer",)))
    assert knows(offered, people) == [True, True, False]


def test_another_self_of_who_began_with_another_run_is_known(robots, tmp_path):
    """A stored partner does not say what the run that it began with was taught."""
    config = dataclasses.replace(configure("scratch", SETTINGS | {"ppo.teachers": ()}), start="runs/elsewhere")
    row = {"person": {"disability": "none", "preference": "default"}, "algorithm": "ippo", "seed": 0}
    assert {self_of(row), self_of(row | {"taught": "shy"})} <= selves_of(config)
    assert self_of(row | {"seed": 1}) not in selves_of(config)


def test_players_from_python_are_told_by_what_they_do(population, two_kinds, tmp_path):
    """Members of two architectures and somebody with a habit, given as one player."""
    strangers = population.select(population.ids[3:])
    people = Population.scripted("scratch-v3", [Person("tremor", "default")], ("shy", "follows"))
    among = Population.merge([two_kinds, population.select(population.ids[:2]), people.select(people.ids[:1])])
    settings = {k: v for k, v in SETTINGS.items() if "human" not in k} | {"env.human.people": among.people}
    config = configure("scratch", settings)
    given = {"human": among.partner("human", env=meeting(among).env)}
    run = Run.create(config, tmp_path / "run", players=given)
    assert all(knows(run, among)) and not any(knows(run, strangers))
    assert knows(run, Population.scripted("scratch-v3", [Person("none", "default")], ("shy", "follows"))) == [
        True,
        False,
    ]


def test_everybodys_own_robot_may_be_of_another_architecture(population, two_kinds):
    """And somebody may have none."""
    people = Population.scripted("scratch-v3", [Person("none", "default")], ("shy",))
    mixed = Population.merge([population.select(population.ids[:2]), people, two_kinds])
    everybody, own = meeting(mixed), meeting(mixed).references()["own"]["return"]
    assert np.isnan(own[2]).all() and np.isfinite(own[[0, 1, 3, 4]]).all()
    for row in (1, 3):
        robot = mixed.select([mixed.ids[row]]).partner("robot", deterministic=True, by_person=False)
        np.testing.assert_allclose(own[row], everybody(robot)["return"][row], rtol=1e-4)


def test_nothing_is_random_and_nobody_stays_where_robots_are_measured(population, tmp_path):
    settings = SETTINGS | {"env.human.random_share": 0.25, "env.human.redraw_every": 3}
    human = meeting_env(stored_run(tmp_path / "e3t", configure("scratch", settings)), population).config.human
    assert (human.random_share, human.redraw_every) == (0.0, 1)


def test_robots_of_other_settings_are_not_compared(robots, tmp_path):
    root, made = robots
    settings = {k: v for k, v in SETTINGS.items() if "human" not in k} | {"env.episode_length": 30}
    longer = stored_run(tmp_path / "l", configure("scratch", settings, partners=made["br"].config.partners))
    with pytest.raises(UsageError, match=r"env.episode_length is 20 in .*/br and 30 in .*/l; only what was measured"):
        report({"br": [made["br"]], "longer": [longer]}, parts_of(root, "test"), episodes=1)


def test_robots_with_and_without_a_clock_are_compared(robots, tmp_path):
    root, made = robots
    settings = {k: v for k, v in SETTINGS.items() if "human" not in k} | {"env.episode_length": 20, "env.clock": 0.0}
    without = stored_run(tmp_path / "w", configure("scratch", settings, partners=made["br"].config.partners))
    assert without.env.observation_sizes["robot"] == made["br"].env.observation_sizes["robot"] - 2
    both, alone = (
        report({name: [one] for name, one in methods.items()}, parts_of(root, "test"), episodes=1)
        for methods in ({"without": without, "br": made["br"]}, {"br": made["br"]})
    )
    for group, name in (("methods", "br"), ("references", "own"), ("references", "expert")):
        got, want = (found["test"][group][name]["return"]["by_pair"] for found in (both, alone))
        np.testing.assert_array_equal(got, want)
    assert both["runs"]["without"][0]["clock"] == 0.0 and "clock" not in both["runs"]["br"][0]


def test_own_robots_see_the_clock_that_they_learned_with(tmp_path):
    """The task's, see above, or that of the runs."""
    population = untrained(clock=0.0)
    settings = {k: v for k, v in SETTINGS.items() if "human" not in k} | {"env.episode_length": 20, "env.clock": 0.0}
    settings["env.human.people"] = population.people
    robot = stored_run(tmp_path / "robot", configure("scratch", settings, partners=("human=shy",)))
    found = report({"shy": [robot]}, {"test": population}, episodes=1)
    assert found["env"]["clock"] == 0.0 and np.isfinite(found["test"]["references"]["own"]["return"]["by_pair"]).all()


def test_members_who_observe_something_else_are_one_line(population):
    """They were trained without seeing the preferences that people here see."""
    env = assistax.make("scratch-v3", engine="mujoco", human={"people": population.people, "visibility": "none"})
    with pytest.raises(UsageError, match=r"humans of the population, architecture ippo-.*, observe"):
        Meeting(env, population, 1)


def test_people_of_one_version_are_not_met_in_another(population):
    env = assistax.make("scratch-v1", engine="mujoco", human={"people": population.people})
    with pytest.raises(UsageError, match=r"is of scratch-v3 and cannot be met in scratch-v1"):
        Meeting(env, population, 1)


@pytest.mark.parametrize(
    ("robots", "where", "words"),
    [
        (Player(Still(7)), None, "robots of mine must be a list"),
        ([Player(Still(7))], "alone", "must be a dict by part"),
    ],
)
def test_what_is_not_given_by_name_and_seed_is_one_line(population, robots, where, words):
    with pytest.raises(UsageError, match=words):
        report({"mine": robots}, population if where else {"test": population}, episodes=1)


def test_nobody_of_the_test_is_there_in_training(robots):
    """A canary: each member's strength tells who is in the room."""
    root, made = robots
    run, parts = made["br"], parts_of(root, "train", "test")
    state = jax.jit(run.trainer.init)(jax.random.key(0))
    collect, seen = jax.jit(run.trainer.collect), set()
    for _ in range(12):
        seen |= {tuple(np.round(one, 3).tolist()) for one in bodies(state.env_state.person)}
        state, _ = collect(state)
    train, test = ({tuple(np.round(one, 3).tolist()) for one in bodies_of(p)} for p in parts.values())
    assert seen == train and not seen & test


def bodies(person):
    return np.stack([np.asarray(x).reshape(len(person.index), -1)[:, 0] for x in jax.tree.leaves(person.disability)], 1)


def bodies_of(population):
    env = meeting(population, 1).env
    rows = jnp.arange(len(population))
    _, states = jax.vmap(env.reset, (0, None, 0))(jax.random.split(jax.random.key(0), len(rows)), 0, rows)
    return bodies(states.person)


@pytest.mark.slow
def test_beside_its_partner_a_robot_reaches_what_its_training_says(population, tmp_path):
    """The evaluation in a training, with draws of its own, and a meeting: means of 128 episodes each."""
    one = population.select(population.ids[1:2])
    one.save(tmp_path / "one")
    settings = {k: v for k, v in SETTINGS.items() if "human" not in k} | {"env.episode_length": 40}
    run = stored_run(tmp_path / "run", configure("scratch", settings, partners=(f"human={tmp_path}/one",)))
    (team,) = run.teams()
    trained = Evaluator(run.env, 128)(team)["metrics"]
    met = Meeting(meeting_env(run, one), one, 128)(team["robot"])
    for name in ("return", "task_return", "preference_return"):
        a, b = np.asarray(trained[name], float), met[name][0]
        error = np.sqrt(a.var(ddof=1) / len(a) + b.var(ddof=1) / len(b))
        assert a.std() > 0 and abs(a.mean() - b.mean()) < 3 * error, name


def test_best_responses_are_references_for_those_whom_they_know(robots):
    root, made = robots
    parts = parts_of(root, "train", "test")
    found = report({"oracle": [made["oracle"]]}, parts, 1, best_responses={"best": made["br"]})
    assert {"best 0", "best 1", "own"} < set(found["train"]["references"])
    assert "best 0" not in found["test"]["references"]
    assert set(found["gap"]["oracle"]["return"]) == {"mean", "ci"}


def test_partners_without_a_robot_are_no_obstacle_to_the_others(population, robots):
    """People with habits have none: beside them nobody is a reference for 1."""
    root, made = robots
    people = Population.scripted("scratch-v3", [Person("none", "default")], ("shy",))
    strangers = [splits.named(f"{root}/pop:random/{part}")[1].ids[0] for part in ("val", "test")]
    mixed = Population.merge([people, population.select(strangers)])
    found = report({"oracle": [made["oracle"]]}, {"test": mixed}, episodes=1)["test"]
    own, still = (found["references"][name]["return"]["by_pair"][0] for name in ("own", "still"))
    assert own[0] is None and None not in own[1:] and None not in still
    alone = report({"oracle": [made["oracle"]]}, {"test": population.select(strangers[1:])}, episodes=1)
    assert alone["test"]["references"]["own"]["return"]["by_pair"][0][0] == own[2]


def test_a_robot_that_observes_something_else_is_refused_before_anybody_plays(robots, tmp_path, monkeypatch):
    root, made = robots
    blind = {k: v for k, v in SETTINGS.items() if "human" not in k} | {"env.episode_length": 20}
    other = stored_run(tmp_path / "other", configure("scratch", blind))
    monkeypatch.setattr(Meeting, "references", lambda *_: pytest.fail("somebody played"))
    for runs in ([made["br"], other], [other]):
        with pytest.raises(UsageError, match="observes 42 numbers, but beside these partners 49: its people had no"):
            report({"mine": runs}, parts_of(root, "test"), episodes=1)


def test_the_report_has_everybody(robots, tmp_path):
    root, made = robots
    assert made["oracle"].env.observation_sizes["robot"] == made["br"].env.observation_sizes["robot"] + 4
    out = tmp_path / "table.json"
    words = f"br={root}/br", f"oracle={root}/oracle", "--population", f"{root}/pop", "--episodes", 2, "--out", out
    printed = assistax_command("teamwork", "evaluate", *words).stdout
    assert "expert" in printed and "br: coordination gap" in printed and out.with_suffix(".png").exists()
    assert all(harm in printed for harm in ("clamping", "impact", "peak force, N"))
    found = json.loads(out.read_text())
    people = {part: [one["disability"] for one in found["people"][part]] for part in ("train", "test")}
    assert people == {part: [one.disability for one in parts_of(root, part)[part].people] for part in people}
    for part in ("train", "test"):
        assert set(found[part]["references"]) == {"still", "random", "expert", "considerate", "own"}
        for one in found[part]["methods"].values():
            assert np.shape(one["return"]["by_pair"]) == (2, len(found["partners"][part]))
        assert set(found[part]["differences"]) == {"oracle"} and set(found[part]["scored"]) == set(SCORES)
    assert set(found["gap"]) == {"br", "oracle"}


def test_a_run_counts_once(robots):
    root, made = robots
    with pytest.raises(UsageError, match="br is given twice as a robot of mine; its seeds would count twice"):
        report({"mine": [made["br"], made["br"]]}, parts_of(root, "test"), episodes=1)


def test_a_robot_made_elsewhere_stands_beside_runs(robots):
    """The robot of a run, without the run, reaches the same; and alone it fills a table."""
    root, made = robots
    (team, *_) = made["br"].teams()
    test = parts_of(root, "test")
    found = report({"run": [made["br"]], "mine": [team["robot"]]}, test, episodes=1)
    run, mine = (found["test"]["methods"][name]["return"] for name in ("run", "mine"))
    assert mine["by_pair"] == run["by_pair"][:1] and found["runs"]["mine"] == [{"policy": "Actor"}]
    alone = report({"mine": [team["robot"]]}, test, episodes=1)  # in the task as it is, not as the run changed it
    assert alone["task"] == found["task"] and set(alone["test"]["references"]) == set(found["test"]["references"])
    assert alone["test"]["methods"]["mine"]["return"]["mean"] > mine["mean"]


def test_cross_play_is_of_members_with_robots_as_they_are_now(population):
    rows = list(population.rows)
    rows[1] = rows[1] | {"fraction": 0.333}
    rows[3] = rows[3] | {"robot": False}
    mixed = dataclasses.replace(population, rows=tuple(rows))
    assert with_robots(mixed).ids == (mixed.ids[0], mixed.ids[2], mixed.ids[4])
    assert set(with_robots(mixed, 2).ids) < {mixed.ids[0], mixed.ids[2], mixed.ids[4]}
    with pytest.raises(UsageError, match="two members"):
        with_robots(mixed.select(mixed.ids[:2]))


@pytest.mark.slow
def test_validity(robots):
    root, _ = robots
    asked = ["teamwork", "validity", f"{root}/pop", "--episodes", 1, "--sample", 2, "--out", root / "validity.json"]
    printed = assistax_command(*asked, "--robots", f"mine={root}/br", "--oracles", f"told={root}/oracle").stdout
    assert "cross-play" in printed and "best single robot, m" in printed
    found = json.loads((root / "validity.json").read_text())
    assert set(found["others"]) == {"still", "expert", "considerate", "mine 0", "mine 1", "told 0", "told 1"}
    assert len(found["others"]["mine 0"]["return"]) == 2
    assert (root / "validity.png").exists() and found["why"] in printed


def test_partners_matter_where_no_single_robot_serves_all():
    """Worked by hand: three robots and people; a still robot has 10 with everybody."""
    nothing, still = np.zeros(3), {"return": np.full(3, 10.0), "success": np.zeros(3)}

    def verdict(returns, success, oracles=(), **others):
        matrix = {"return": np.array(returns, float), "success": np.array(success, float)}
        return judge(matrix, {"still": still} | others, oracles)

    own = [[110, 10, 10], [10, 110, 10], [10, 10, 110]]
    apart = verdict(own, np.eye(3))
    assert apart["matters_in"] == ["return", "success"] and apart["lost"] == {"return": 1.0, "success": 1.0}
    assert apart["best_single"]["success"]["mean"] == pytest.approx(1 / 3)
    everybody = {"return": np.full(3, 105.0), "success": np.full(3, 0.95)}
    served = verdict(own, np.eye(3), mine=everybody)
    assert (
        not served["valid"] and "one robot, mine, has 95% with all, who knows the partner, their own" in served["why"]
    )
    assert served["best_single"]["return"] == {"robot": "mine", "mean": 105.0}
    assert verdict(own, np.eye(3), expert=everybody)["valid"]  # who is told everything does not compete
    less = {"return": np.full(3, 10 + 100 / 1.11), "success": nothing}
    assert verdict(own, np.zeros((3, 3)), mine=less)["valid"]  # 11 % more than the single robot, above still
    told = {"return": np.full(3, 110.0), "success": np.ones(3)}
    failing = {"return": np.full(3, 10.0), "success": np.full(3, 0.8)}
    half = np.diag([1.0, 1.0, 0.0])  # whose own robot fails with one person
    poor = np.full((3, 3), 10.0)
    assert not verdict(poor, half, mine=failing)["valid"]
    assert verdict(poor, half, ("told",), mine=failing, told=told)["valid"]
    alike = verdict([[110, 100, 100]] * 3, np.ones((3, 3)))
    assert not alike["valid"] and "cross-play loses" in alike["why"] and "one robot, member 0" in alike["why"]
    nobody = verdict(np.full((3, 3), 10), np.zeros((3, 3)))
    assert not nobody["valid"]


def test_partners_may_matter_in_how_they_like_it_alone():
    """By hand: all robots succeed with all people, who like one thing each; a middling robot has half of all."""
    ones, likes = np.ones((3, 3)), 100.0 * np.eye(3)
    matrix = {"return": 500 + likes, "success": ones, "gated_return": 500 + likes, "gated_preference_return": likes}
    still = {name: np.zeros(3) for name in matrix}
    found = judge(matrix, {"still": still})
    assert found["matters_in"] == ["gated_preference_return"] and found["lost"]["gated_preference_return"] == 1.0
    middling = {name: x[0] for name, x in matrix.items()} | {"gated_preference_return": np.full(3, 91.0)}
    found = judge(matrix, {"still": still, "middling": middling})
    assert not found["valid"] and "one robot, middling, has 91 with all" in found["why"]
    middling["gated_preference_return"] = np.full(3, 100 / 1.11)
    assert judge(matrix, {"still": still, "middling": middling})["valid"]


# -- several episodes in a row --------------------------------------------------------------------

STEPS = 130  # more than a second, after which the memory is read


@dataclass(frozen=True)
class Counting:
    """Does `later` from its step `STEPS` on, over all episodes, and nothing before; its memory is the steps done."""

    early: float = 0.0
    later: float = 0.5

    def initial_carry(self):
        return jnp.zeros(1), ()

    def act(self, params, carry, obs, reset, key):
        count = jnp.where(reset, 0.0, carry[0])
        return jnp.full(7, jnp.where(count[0] < STEPS, self.early, self.later)), (count + 1.0, ())


def test_a_memory_lasts_from_one_episode_to_the_next(population):
    env = assistax.make("scratch-v3", engine="mujoco", episode_length=STEPS, human={"people": population.people})
    series = Series(env, population, in_a_row=2, repeats=2)
    mixed, still, moving = (series(Player(Counting(*args))) for args in ((0.0, 0.5), (0.0, 0.0), (0.5, 0.5)))
    assert mixed["return"].shape == (5, 2, 2) and mixed["memory"].shape == (5, 2, 1, 1)
    np.testing.assert_array_equal(mixed["return"][..., 0], still["return"][..., 0])
    np.testing.assert_array_equal(mixed["return"][..., 1], moving["return"][..., 1])
    assert (still["return"][..., 1] != moving["return"][..., 1]).all()
    np.testing.assert_array_equal(mixed["memory"], 125.0)
    assert len(np.unique(still["return"])) == 20  # partners, repeats and episodes are different draws


def test_what_an_episode_more_is_worth():
    np.testing.assert_allclose(slope(np.array([[1.0, 2.0, 3.0], [5.0, 5.0, 5.0], [2.0, 0.0, 1.0]])), [1.0, 0.0, -0.5])


def test_a_probe_reads_what_is_there_of_partners_it_has_not_seen():
    rng = np.random.default_rng(0)
    people, groups = rng.normal(size=(40, 7)) * 10.0 + 3.0, np.repeat(np.arange(40), 6)
    truth = people[groups]
    told = truth @ rng.normal(size=(7, 32)) + 0.1 * rng.normal(size=(240, 32))
    half = np.concatenate([truth[:, :3], rng.normal(size=(240, 20))], 1)
    who = np.eye(40)[groups]  # knows everybody and nothing of them
    assert probe(told, truth, groups) > 0.9
    assert 0.25 < probe(half, truth, groups) < 0.5
    assert probe(who, truth, groups) < 0.05 and probe(rng.normal(size=(240, 32)), truth, groups) < 0.05
    truth[:, 2] = 1.0
    assert probe(told, truth, groups) > 0.9  # what is the same in everybody is not asked for
    assert np.isnan(probe(np.zeros((240, 0)), truth, groups))


def test_a_summary_has_means_by_episode_and_their_slope(population):
    one = {"return": np.array([[[1.0, 2.0], [3.0, 4.0]]] * 5), "memory": np.zeros((5, 2, 1, 0))}
    found = summarize_series([one, one | {"return": one["return"] + 1.0}], about(population))
    assert found["return"]["by_episode"] == [2.5, 3.5] and found["return"]["slope"] == 1.0
    assert found["probe"] == {"preference": {"1": None}, "body": {"1": None}}
    zero, best = np.full(5, 2.0), np.array([4.0, 4.0, 6.0, 3.0, 4.0])
    scored = summarize_series([one], about(population), Scale(zero, best))["score"]
    assert scored["by_episode"] == [0.0, round((0.5 + 0.5 + 0.25 + 1.0 + 0.5) / 5, 4)]  # they have 2.0 and 3.0
    unknown = np.append(best[:4], np.nan)
    assert "score" not in summarize_series([one], about(population), Scale(zero, unknown))
    truths = about(population)
    assert truths["preference"].shape == (5, 7) and truths["body"].shape == (5, 4)
    assert truths["body"][2].tolist() == pytest.approx([0.0, 5.0, 0.4, 1.0])


def test_the_command_tells_every_episode(robots, tmp_path):
    root, _ = robots
    words = "--population", f"{root}/pop", "--in-a-row", 2, "--repeats", 1, "--out", tmp_path / "found.json"
    printed = assistax_command("teamwork", "adapt", f"br={root}/br", *words).stdout
    assert "2 episodes in a row" in printed and "\nbr " in printed
    found = json.loads((tmp_path / "found.json").read_text())["methods"]["br"]
    assert len(found["safe_success"]["by_episode"]) == 2 and found["probe"]["body"] == {}
