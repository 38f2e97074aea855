"""Populations as folders of data: what is stored is what is loaded, or one line says which file is not."""

import dataclasses
import json
import re
import shutil

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from commands import assistax as assistax_command
from stored import SMALL, small, stored_run

import assistax
from assistax.adapters.partner import find_player
from assistax.errors import UsageError
from assistax.evaluation import play
from assistax.evaluation.playing import Evaluator, summarize
from assistax.human import Person
from assistax.human.disability import DISABILITIES
from assistax.learning.normalizer import RunningStats
from assistax.learning.partners import Partners
from assistax.learning.ppo import PPO, PPOConfig
from assistax.policies import Player, scripted_policy
from assistax.policies.habits import HABITS
from assistax.teamwork.gather import gather
from assistax.teamwork.strangers import knows
from assistax.training import loop, splits
from assistax.training.configuration import configure, trained_env
from assistax.training.partners import find_partner
from assistax.training.population import Population, is_population
from assistax.training.run import Run
from assistax.training.team_file import params_like

WORDS = ("none", "tremor", "weakness", "limited_range", "tremor=0.2", "strength=0.5")
CONFIG = PPOConfig(num_steps=4, num_minibatches=1, hidden=(8, 8), initial_log_std=-1.0)


@pytest.fixture(scope="module")
def teams(scratch):
    """Six untrained teams, each with a person and another seed."""
    trainer = PPO(scratch, CONFIG, 2, 1)
    init, made = jax.jit(trainer.init), []
    for seed, words in enumerate(WORDS):
        params = trainer.policy_params(init(jax.random.key(seed)))
        row = {"task": scratch.name, "algorithm": "ippo", "seed": seed, "steps": 64, "robot": True}
        row |= {"person": {"disability": words, "preference": "none"}, "mean_return": 1.0, "success_rate": 0.5}
        made.append((row, {agent: Player.of(trainer.policy(False), params[agent]) for agent in params}))
    return made


@pytest.fixture(scope="module")
def population(teams):
    return Population.of_teams(teams)


@pytest.fixture
def folder(population, tmp_path):
    population.save(tmp_path / "pop")
    return tmp_path / "pop"


def test_what_is_loaded_acts_as_what_was_saved(population, folder, teams, scratch):
    loaded = Population.load(folder)
    assert loaded.rows == population.rows and loaded.people == population.people and len(loaded) == 6
    obs = jax.random.normal(jax.random.key(9), (scratch.observation_sizes["human"],))
    partner = loaded.partner("human", deterministic=True)
    partner.check()
    for i, (_, team) in enumerate(teams):
        policy = dataclasses.replace(team["human"].policy, deterministic=True)
        args = policy.initial_carry(), obs, jnp.bool_(True), jax.random.key(0)
        own, _ = policy.act(team["human"].member(0), *args)
        stored, _ = partner.policy.act(partner.member(i), *args)
        np.testing.assert_allclose(stored, own, atol=2e-3)  # half precision: 11 bits
    assert not loaded.partner("human").policy.deterministic


def test_the_order_of_the_rows_means_nothing(folder, population):
    rows = (folder / "manifest.jsonl").read_text().splitlines()
    (folder / "manifest.jsonl").write_text("\n".join(reversed(rows)) + "\n")
    loaded = Population.load(folder)
    assert loaded.ids == population.ids[::-1]
    for one in population.rows:
        other = next(row for row in loaded.rows if row["id"] == one["id"])
        jax.tree.map(np.testing.assert_array_equal, loaded.member(other), population.member(one))


def test_an_id_changes_with_any_bit_and_with_who_it_is(teams):
    row, team = teams[0]
    ids = {Population.of_teams([(row, team)]).ids[0]}
    ids |= {Population.of_teams([(row | {"person": {"disability": "tremor", "preference": "none"}}, team)]).ids[0]}
    changed = jax.tree.map(lambda x: x, team["human"].params)
    changed["actor"]["log_std"] = changed["actor"]["log_std"].at[0, 1].add(1e-3)
    other = team | {"human": dataclasses.replace(team["human"], params=changed)}
    ids |= {Population.of_teams([(row, other)]).ids[0]}
    assert len(ids) == 3


def test_damage_is_named_or_does_no_harm(folder, population, teams):
    """Flipped bytes, cut files, edited rows, renamed and foreign weights: identical members, or one clear line."""
    split = splits.path_of(folder, "random")
    splits.save(split, splits.split(population, "random"))
    rng, outcomes = np.random.default_rng(0), []
    Population.of_teams(teams[1:]).save(folder.parent / "foreign")  # the same architecture
    files = sorted(path for path in folder.rglob("*") if path.is_file())
    assert len(files) == 4
    for case in range(200):
        path = files[case % 4]
        whole = path.read_bytes()
        damage = DAMAGE[case // 4 % len(DAMAGE)]
        damage(path, whole, rng)
        try:
            loaded = Population.load(folder)
            splits.load(split, loaded)  # of anybody in the population
        except UsageError as error:
            outcomes.append(damage)
            assert "\n" not in str(error)
        else:
            assert loaded.rows == population.rows
            for row in loaded.rows:
                jax.tree.map(np.testing.assert_array_equal, loaded.member(row), population.member(row))
        path.write_bytes(whole)
        path.with_suffix(".away").unlink(missing_ok=True)
    assert len(outcomes) > 150 and set(outcomes) == set(DAMAGE)
    Population.load(folder)


def flipped(path, whole, rng):
    at = int(rng.integers(len(whole)))
    path.write_bytes(whole[:at] + bytes([whole[at] ^ (1 << int(rng.integers(8)))]) + whole[at + 1 :])


def cut(path, whole, rng):
    path.write_bytes(whole[: int(rng.integers(len(whole)))])


def edited(path, whole, rng):
    """A number or a word becomes another one of the same length."""
    if path.suffix == ".safetensors":
        return flipped(path, whole, rng)
    places = [match.start() for match in re.finditer(rb"\d", whole)]
    at = int(rng.choice(places))
    path.write_bytes(whole[:at] + b"%d" % ((int(whole[at : at + 1]) + 1) % 10) + whole[at + 1 :])


def without_a_line(path, whole, rng):
    if path.suffix == ".safetensors":
        return cut(path, whole, rng)
    lines = whole.splitlines(keepends=True)
    del lines[int(rng.integers(len(lines)))]
    path.write_bytes(b"".join(lines))


def renamed(path, whole, rng):
    path.rename(path.with_suffix(".away"))


def foreign(path, whole, rng):
    there = path.parents[1] / "foreign" / path.name
    if there.exists():
        path.write_bytes(there.read_bytes())


DAMAGE = flipped, cut, edited, without_a_line, renamed, foreign


def edit(folder, change):
    """Change the manifest's rows."""
    rows = [json.loads(line) for line in (folder / "manifest.jsonl").read_text().splitlines()]
    change(rows)
    (folder / "manifest.jsonl").write_text("".join(json.dumps(row) + "\n" for row in rows))


@pytest.mark.parametrize(
    "change",
    (
        lambda rows: rows[2].update(success_rate=0.9),
        lambda rows: rows[2].update(algorithm="masac"),
        lambda rows: rows[2].update(robot=False),
        lambda rows: rows[2].update(fraction=0.333),
        lambda rows: rows[2].pop("mean_return"),
        lambda rows: rows.pop(),
    ),
)
def test_a_manifest_is_not_edited_unnoticed_and_in_old_populations_it_is_said(folder, population, change):
    edit(folder, change)
    with pytest.raises(UsageError, match=r"manifest\.jsonl is not what was saved, as population\.json tells"):
        Population.load(folder)
    (folder / "population.json").unlink()
    assert set(Population.load(folder).ids) <= set(population.ids)
    assert "is not checked" in assistax_command("population", "verify", folder).stdout


def test_members_that_are_swapped_are_found_out(folder):
    def swap(rows):
        rows[0]["row"], rows[1]["row"] = rows[1]["row"], rows[0]["row"]

    edit(folder, swap)
    (folder / "population.json").unlink()  # as in populations of earlier versions
    with pytest.raises(UsageError, match=r"member .* is not what was saved"):
        Population.load(folder)


def test_a_selection_is_a_population(population):
    some = population.select([population.ids[4], population.ids[1]])
    assert [row["person"]["disability"] for row in some.rows] == ["tremor=0.2", "tremor"]
    jax.tree.map(np.testing.assert_array_equal, some.member(some[0]), population.member(population[4]))
    assert some.partner().members == 2
    with pytest.raises(UsageError, match="There is no member nobody in this population of 6"):
        population.select(["nobody"])


def test_a_split_parts_everybody_and_refuses_what_is_none(population, tmp_path):
    for kind in ("random", "interpolate", "extrapolate", "disability"):
        parts = splits.split(population, kind, seed=1)
        assert sorted(one for ids in parts.values() for one in ids) == sorted(population.ids)
        assert parts == splits.split(population.select(population.ids[::-1]), kind, seed=1)
        splits.save(tmp_path / "split.json", parts)
        assert splits.load(tmp_path / "split.json", population) == parts
    parts = splits.split(population)
    for bad, message in (
        (parts | {"val": parts["test"][:1]}, "in two of its parts"),
        (parts | {"val": ["somebody"]}, "names somebody, who is not in this population"),
        (parts | {"test": []}, "others to test with"),
    ):
        with pytest.raises(UsageError, match=message):
            splits.check(population, bad)
    with pytest.raises(UsageError, match="no preferences to split them by"):
        splits.split(population, "extreme")
    with pytest.raises(UsageError, match="the same algorithm"):
        splits.split(population, "algorithm")


def test_bodies_are_parted_whole():
    people = [Person(body, liking) for body in DISABILITIES for liking in ("none", "default")]
    many = Population.scripted("scratch-v3", people, ("offers",))
    body = {row["id"]: row["person"]["disability"] for row in many.rows}
    for kind, number in (("interpolate", 4), ("extrapolate", 4)):
        parts = splits.split(many, kind)
        seen, held = ({body[one] for part in some for one in parts[part]} for some in (["train"], ["val", "test"]))
        assert len(seen) == number and not seen & held and len(seen | held) == 7
    assert "tremor" in {body[one] for one in splits.split(many, "interpolate")["train"]}  # the strongest of the seven


def test_a_name_is_no_population_because_one_is_here(folder, monkeypatch):
    assert is_population(folder) and is_population(f"{folder}:random/train")
    monkeypatch.chdir(folder)
    assert not is_population("still")


def test_what_splits_part_by(population):
    words = {row["id"]: row["person"]["disability"] for row in population.rows}
    of = lambda parts, part: {words[one] for one in parts[part]}  # noqa: E731
    assert "weakness" in of(splits.split(population, "extrapolate"), "test")  # the least strength
    assert "none" in of(splits.split(population, "extrapolate"), "train")
    preferring = [
        (row | {"person": {"disability": "none", "preference": f"weights={weight},0.3,-0.03"}, "seed": i}, team)
        for i, (weight, (row, team)) in enumerate(
            zip((0.1, 0.9, 0.5, 0.8, 0.2, 0.3), preferring_teams(population), strict=True)
        )
    ]
    extreme = splits.split(Population.of_teams(preferring), "extreme")
    people = {row["id"]: row["seed"] for row in Population.of_teams(preferring).rows}
    assert {people[one] for one in extreme["train"]} == {1, 3, 2}  # at most half of six


def test_who_passes_for_the_same_person_twice_is_in_one_part(population):
    """As in two populations of the same people, trained for other numbers of steps, that were merged."""
    twice = [row | {"id": f"later {row['id']}", "steps": 2 * row["steps"]} for row in population.rows]
    merged = dataclasses.replace(population, rows=(*population.rows, *twice))
    for seed in range(5):
        parts = splits.split(merged, seed=seed)
        of = {one: part for part, ids in parts.items() for one in ids}
        assert all(of[row["id"]] == of[f"later {row['id']}"] for row in population.rows)
        assert sorted(of) == sorted(merged.ids)


def test_people_who_were_taught_one_way_are_left_out_as_wholes(population):
    ways = ("offers", "offers_second_way", "offers_third_way")
    taught = [
        (row | {"taught": ways[i % 3], "seed": i}, team) for i, (row, team) in enumerate(preferring_teams(population))
    ]
    made = Population.of_teams(taught)
    of = {row["id"]: row["taught"] for row in made.rows}
    parts = splits.split(made, "taught")
    met = {part: {of[one] for one in ids} for part, ids in parts.items()}
    assert met["train"] and met["test"] and not met["train"] & (met["val"] | met["test"])
    with pytest.raises(UsageError, match="taught"):
        splits.split(population, "taught")


def test_earlier_selves_go_with_who_was_taught_the_same(population):
    """Six members of one body and one seed, of whom two are earlier selves of the first two."""
    who = [("offers", None), ("shy", None), ("offers", 0.333), ("shy", 0.333), ("follows", None), ("follows", 0.667)]
    same = {"person": {"disability": "none", "preference": "none"}, "seed": 0}
    teams = [
        (row | same | {"taught": habit} | ({"fraction": share} if share else {}), team)
        for (habit, share), (row, team) in zip(who, preferring_teams(population), strict=True)
    ]
    made = Population.of_teams(teams)
    found = splits.with_earlier(made, made.select([made.ids[1]]))
    assert found.ids == (made.ids[1], made.ids[3])


def preferring_teams(population):
    for row in population.rows:
        one = population.select([row["id"]])
        yield dict(row), {agent: one.partner(agent) for agent in ("robot", "human")}


def test_conventions_are_left_out_as_wholes(population):
    """Three groups by whom they are served well, whatever the robots' levels."""
    ids = list(population.ids)
    group = np.arange(len(ids)) % 2
    rng = np.random.default_rng(0)
    returns = (
        100.0 * (group[:, None] == group[None])
        + rng.normal(size=(len(ids),) * 2)
        + 50.0 * rng.normal(size=(len(ids), 1))
    )
    played = {"ids": ids, "matrix": {"return": returns.tolist()}}
    parts = splits.split(population, "convention", crossplay=played)
    of = dict(zip(ids, group, strict=True))
    assert len({of[one] for one in parts["train"]}) == 1 and {of[one] for one in parts["train"]}.isdisjoint(
        of[one] for one in parts["test"]
    )
    with pytest.raises(UsageError, match="needs a cross-play"):
        splits.split(population, "convention")
    with pytest.raises(UsageError, match="is of other members"):
        splits.split(population, "convention", crossplay=played | {"ids": ids[1:]})


def test_everybody_of_several_kinds_acts_as_alone(population, scratch):
    """PPO, another architecture and scripted people in one player, in training's way and in evaluation's."""
    other = PPO(scratch, dataclasses.replace(CONFIG, hidden=(4, 4), recurrent=True), 2, 1)
    params = other.policy_params(jax.jit(other.init)(jax.random.key(7)))
    row = dict(population[0]) | {"seed": 9}
    gru = Population.of_teams([(row, {agent: Player.of(other.policy(False), params[agent]) for agent in params})])
    scripted = Population.scripted(scratch.name, [population.people[0]], ("offers", "random"))
    everybody = Population.merge([population, scripted, gru, population])
    assert len(everybody) == len(population) + 3 and len(set(everybody.ids)) == len(everybody)
    mixed = everybody.partner("human", deterministic=True, env=scratch)
    mixed.check()
    obs, state = scratch.reset(jax.random.key(3))
    seen = obs["human"], state, jnp.bool_(True), jax.random.key(5)
    for i, row in enumerate(everybody.rows):
        alone = everybody.select([row["id"]]).partner("human", deterministic=True, env=scratch)
        own, _ = alone.act(alone.member(0), alone.initial_carry(), *seen)
        picked, carry = mixed.act(mixed.member(i), mixed.initial_carry(), *seen)
        read, also = mixed.act_as(jnp.int32(i), mixed.initial_carry(), *seen)
        np.testing.assert_allclose(picked, own, atol=1e-6)
        np.testing.assert_allclose(read, own, atol=1e-6)
        jax.tree.map(lambda a, b: np.testing.assert_allclose(a, b, atol=1e-6), carry, also)


KINDS = {
    "feed-forward": ("ippo", {"ppo.hidden": (8, 8)}),
    "GRU": ("ippo", {"ppo.hidden": (8, 8), "ppo.recurrent": True}),
    "shared": ("ippo", {"ppo.hidden": (8, 8), "ppo.share_parameters": True}),
    "model of the partner": ("ippo", {"ppo.hidden": (8, 8), "ppo.partner_code": 4}),
    "mappo": ("mappo", {"ppo.hidden": (8, 8), "ppo.recurrent": True}),
    "masac": ("masac", {"sac.hidden": (8, 8)}),
    "isac": ("isac", {"sac.hidden": (4, 4)}),
}


def test_members_of_every_kind_act_as_in_their_runs_and_forget_at_the_end_of_an_episode(tmp_path):
    """All in one player, two episodes with the same observations, against each policy as its run has it."""
    own, members, rng = [], [], np.random.default_rng(0)
    for seed, (algorithm, settings) in enumerate(KINDS.values()):
        env, trainer = trained_env(configure("scratch", settings, algorithm=algorithm, engine="mujoco", num_envs=8))
        params = jax.tree.map(lambda x: rng.uniform(-0.5, 0.5, x.shape).astype(x.dtype), params_like(trainer))
        for one in params.values():
            mean = one["normalizer"].mean
            one["normalizer"] = RunningStats(np.float32(100), mean, 100 + mean)  # a spread of about 1
        own.append((trainer.policy(True), params))
        row = {"task": env.name, "algorithm": algorithm, "seed": seed, "steps": 64, "robot": True}
        row |= {"person": {"disability": "none", "preference": "none"}}
        members.append((row, {agent: Player.of(trainer.policy(False), params[agent]) for agent in params}))
    Population.of_teams(members).save(tmp_path / "pop")
    population, number = Population.load(tmp_path / "pop"), len(KINDS)
    for agent in env.agents:
        partners = Partners(env, number, {agent: population.partner(agent, deterministic=True, by_person=False)})
        episode = rng.normal(size=(4, env.observation_sizes[agent])).astype(np.float32)

        def acted(resets, agent=agent, partners=partners, episode=episode):
            state, act, actions = partners.init(jax.random.key(0)), jax.jit(partners.act), []
            state[agent]["index"] = jnp.arange(number)
            for obs, reset in zip([*episode, *episode], resets, strict=True):
                seen = {agent: jnp.tile(obs, (number, 1))}, jnp.full(number, reset), jax.random.key(1)
                action, state = act(state, None, *seen)
                actions.append(action[agent])
            return np.stack(actions)

        first = np.arange(8) % 4 == 0
        actions, unending = acted(first), acted(np.arange(8) == 0)
        np.testing.assert_array_equal(actions[:4], actions[4:])
        for i, (name, (policy, params)) in enumerate(zip(KINDS, own, strict=True)):
            carry = policy.initial_carry()
            for t, obs in enumerate(episode):
                wanted, carry = policy.act(params[agent], carry, obs, jnp.bool_(t == 0), jax.random.key(1))
                np.testing.assert_allclose(actions[t, i], wanted, atol=2e-3, err_msg=f"{name}, step {t}")
            remembers = name in ("GRU", "model of the partner", "mappo")
            assert (np.abs(unending[4, i] - actions[4, i]).max() > 1e-3) == remembers, name
        assert len({tuple(one) for one in actions[0].round(3).tolist()}) == number


class Tells:
    """A person whose first action says which member plays."""

    privileged = False

    def initial_carry(self):
        return ()

    def act(self, params, carry, obs, reset, key):
        return jnp.full(3, params), carry


def test_person_and_member_are_one_draw(population):
    env = assistax.make("scratch-v0", engine="mujoco", episode_length=3, human={"people": population.people})
    told = jnp.linspace(0.1, 0.6, len(population))
    player = Player(Tells(), told, len(population), by_person=True)
    team = {"robot": Player(scripted_policy("still", env, "robot")), "human": player}
    result = play(env, team, 8)
    assert len(set(result["person"].tolist())) > 2
    seats = Partners(env, 8, {"human": player})
    obs, state = jax.vmap(env.reset)(jax.random.split(jax.random.key(0), 8))
    actions, _ = seats.act(seats.init(jax.random.key(1)), state, obs, jnp.ones(8, bool), jax.random.key(2))
    np.testing.assert_allclose(actions["human"][:, 0], told[state.person.index])


def test_some_are_drawn_and_populations_are_listed(folder, population, tmp_path, capsys):
    some, mixed = population.sample(3, seed=1), population.select(population.ids[::-1])
    assert len(set(some.ids)) == 3 and some.ids == mixed.sample(3, seed=1).ids
    drawn = [one for seed in range(200) for one in population.sample(3, seed=seed).ids]
    assert all(70 < drawn.count(one) < 130 for one in population.ids)
    splits.save(splits.path_of(folder, "random"), parts := splits.split(population, "random"))
    out = tmp_path / "some"
    assistax_command("population", "sample", f"{folder}:random/train", "--number", 2, "--out", out, "--habits")
    found = Population.load(out)
    assert len([one for one in found.ids if one in parts["train"]]) == 2 and len(found) == 2 + len(HABITS)
    assert Population.scripted(found.task, [found.people[0]]).ids == found.ids[2:]
    scripted = tmp_path / "scripted"
    asked = ["scripted", "scratch-v0", "--habits", "shows,shows_second_way", "--people", "8x3", "--out", scripted]
    assert "48 members of scratch-v0" in assistax_command("population", *asked).stdout
    assert {(row["habit"], row["person"]["disability"]) for row in Population.load(scripted).rows} == {
        (habit, body) for habit in asked[3].split(",") for body in ("none", *DISABILITIES)
    }
    parts = splits.split(Population.load(scripted), "habit")  # two habits: one to train, one to test with
    assert [len(parts[name]) for name in ("train", "val", "test")] == [24, 0, 24]
    shutil.rmtree(scripted)
    with pytest.raises(UsageError, match="a habit or a person is given more than once"):
        Population.scripted("scratch-v0", found.people[:1], ("shy", "shy"))
    head, *rows = assistax_command("population", "list", tmp_path).stdout.splitlines()
    assert head.split() == ["population", "task", "members", "people", "size"]
    assert [row.split()[:4] for row in rows] == [
        [str(folder), "scratch-v0", "6", "6"],
        [str(out), "scratch-v0", str(len(found)), "2"],
    ]
    assert assistax_command("population", "list", out).stdout.count("scratch-v0") == 1
    for words, said in (
        (("sample", folder, "--number", 7, "--out", tmp_path / "new"), "From 6 members 1 to 6 can be drawn, not 7."),
        (("sample", folder, "--number", 1, "--out", tmp_path / "new", "--seed=-1"), "seed must be from 0"),
        (("split", folder, "--seed=-1"), "seed must be from 0"),
        (("list", folder / "splits"), f"There is no population in {folder}/splits"),
    ):
        with pytest.raises(SystemExit):
            assistax_command("population", *words)
        assert said in capsys.readouterr().err


def test_where_nothing_can_be_written_a_line_says_so(folder, tmp_path, capsys):
    (file := tmp_path / "file").write_text("")
    for words, said in (
        (("merge", file, folder), f"Cannot write {file}: File exists"),
        (("merge", file / "pop", folder), f"Cannot write {file}/pop: Not a directory"),
        (("split", folder, "--kind", "disability", "--out", file / "split.json"), f"Cannot write {file}/split.json:"),
        (("split", folder, "--kind", "disability", "--out", tmp_path), f"Cannot write {tmp_path}: Is a directory"),
        (("show", folder, "--out", tmp_path / "nowhere/who.png"), f"The folder {tmp_path}/nowhere of --out does not"),
        (("show", folder, "--out", tmp_path / "who.gif"), "Can write .png"),
    ):
        with pytest.raises(SystemExit):
            assistax_command("population", *words)
        error = capsys.readouterr().err
        assert said in error and error.count("\n") == 1, words


def test_a_member_for_each_person_or_one_line(population, scratch):
    """Beside another number of people some members would never play; every way to play with them says so."""
    people = {"people": population.people[:2]}
    env = assistax.make("scratch-v0", engine="mujoco", episode_length=3, human=people)
    still = Player(scripted_policy("still", scratch, "robot"))
    mixed = Population.merge([population, Population.scripted(scratch.name, [Person()], ("shy",))])
    for one, number in ((population, 6), (mixed, 7)):
        player = one.partner("human", env=env)
        for play_with in (
            lambda player: Partners(env, 4, {"human": player}),
            lambda player: play(env, {"robot": still, "human": player}, 2),
            lambda player: find_player(player, env, "human"),
        ):
            with pytest.raises(UsageError, match=f"whose {number} members are each somebody .* where these are 2"):
                play_with(player)
    find_player(population.partner("human", by_person=False), env, "human")
    find_player(population.select(population.ids[:2]).partner("human"), env, "human")


def test_bad_folders_are_one_line(tmp_path, population):
    with pytest.raises(UsageError, match=r"is not a population: it has no manifest\.jsonl"):
        Population.load(tmp_path)
    (tmp_path / "something").write_text("")
    with pytest.raises(UsageError, match="is not empty"):
        population.save(tmp_path)
    with pytest.raises(UsageError, match="holds nobody twice"):
        Population.of_teams(_twice(population))


def _twice(population):
    row = dict(population[0])
    partner = {agent: population.select([row["id"]]).partner(agent) for agent in ("robot", "human")}
    return [(row, partner), (row, partner)]


BRIEF = SMALL | {"evaluations": 1, "evaluation_episodes": 3}


def test_a_robot_trains_with_a_population(teams, tmp_path, monkeypatch):
    monkeypatch.setattr("assistax.evaluation.film.film", lambda *_, **__: None)
    population = Population.of_teams([(row | {"task": "scratch-v0"}, team) for row, team in teams])
    config = configure("scratch-v0", BRIEF | {"env.human.people": population.people}, num_envs=8, steps=128)
    run = Run.create(config, tmp_path / "run", players={"human": population.partner("human")})
    assert loop.train(run)["steps"] == 128
    assert run.trainer.learners == ("robot",)


def test_the_command_gathers_finished_runs(tmp_path, monkeypatch):
    monkeypatch.setattr("assistax.evaluation.film.film", lambda *_, **__: None)
    config = configure("scratch", BRIEF | {"env.human.disability": "tremor"}, num_envs=8, steps=64, num_seeds=2)
    run = Run.create(config, tmp_path / "run")
    with pytest.raises(UsageError, match="is not finished"):
        gather([run])
    assert loop.train(run)
    pop = tmp_path / "pop"
    assert "2 members of scratch-v3" in assistax_command("population", "make", pop, tmp_path / "run").stdout
    listed = assistax_command("population", "show", pop, "--out", tmp_path / "who.png").stdout
    assert (tmp_path / "who.png").stat().st_size > 5000
    assert listed.count("tremor") == 2 and "seed 1" in listed and "safely" in listed.splitlines()[0]
    assert assistax_command("population", "verify", pop).stdout == "2 members of scratch-v3, all as they were saved\n"
    own, stored = run.teams()[1]["human"], Population.load(pop).partner("human", deterministic=True)
    obs = jax.random.normal(jax.random.key(9), (run.env.observation_sizes["human"],))
    args = own.policy.initial_carry(), obs, jnp.bool_(True), jax.random.key(0)
    one, other = own.policy.act(own.member(0), *args)[0], stored.policy.act(stored.member(1), *args)[0]
    np.testing.assert_allclose(one, other, atol=2e-3)


def test_a_population_is_a_partner_by_name(teams, tmp_path, monkeypatch):
    monkeypatch.setattr("assistax.evaluation.film.film", lambda *_, **__: None)
    folder = tmp_path / "pop"
    everybody = Population.of_teams([(row | {"task": "scratch-v0"}, team) for row, team in teams])
    scripted = Population.scripted("scratch-v0", [everybody.people[0]], ("offers", "still"))
    Population.merge([everybody, scripted]).save(folder)
    assistax_command("population", "split", folder, "--kind", "algorithm")
    sizes = ["--set", *(f"{k}={v}".replace(" ", "") for k, v in BRIEF.items())]
    out = tmp_path / "run"
    for part in ("train", "test"):
        with pytest.raises(UsageError, match="Name a split and a part"):
            find_partner(f"{folder}:nobody/{part}", None, "human")
        assert len(splits.named(f"{folder}:algorithm/{part}")[1]) in (2, 6)
    who = f"human={folder}:algorithm/test"
    options = "--num-envs", 8, "--steps", 128, "--partner", who, "--out", out
    assistax_command("train", "scratch-v0", *options, *sizes)
    chosen = splits.named(f"{folder}:algorithm/test")[1]
    strangers = f"human={folder}:algorithm/train"  # other people than those of training
    met = assistax_command("evaluate", out, "--partner", strangers, "--episodes", 2, "--json")
    assert json.loads(met.stdout)["partners"] == [strangers]
    result = tmp_path / "result"  # which has no copy, and finds the population while it is what it was
    result.mkdir()
    for name in ("config.json", "policies.safetensors"):
        shutil.copy(out / name, result)
    assert Run.open(result).partners["human"].population.ids == chosen.ids
    assert [knows(Run.open(result), chosen.select([one])) for one in chosen.ids] == [[True]] * len(chosen)
    splits.save(splits.path_of(folder, "algorithm"), {"train": chosen.ids[1:], "val": [], "test": chosen.ids[:1]})
    with pytest.raises(UsageError, match=r"result has no copy of its human, in a folder partners, and .* no longer"):
        Run.open(result)
    shutil.rmtree(folder)  # the run has its own copy
    run = Run.open(out)
    assert run.trainer.learners == ("robot",) and run.env.config.human.people == chosen.people
    assert Population.load(out / "partners/human").ids == chosen.ids
    report = json.loads(assistax_command("evaluate", out, "--episodes", 3, "--json").stdout)
    assert report["episodes"] == 3
    other = assistax_command("evaluate", out, "--partner", "human=shy", "--episodes", 2, "--json")
    assert json.loads(other.stdout)["partners"] == ["human=shy"]
    (out / "partners/human/manifest.jsonl").write_text("")
    with pytest.raises(UsageError, match="has no members"):
        Run.open(out)


def test_robots_meet_everybody_of_a_population(teams, tmp_path, capsys):
    """A column for each member, as if nobody else were there."""
    folder, run = tmp_path / "pop", stored_run(tmp_path / "run", small("scratch-v0"))
    everybody = Population.of_teams([(row | {"task": "scratch-v0"}, team) for row, team in teams])
    Population.merge([everybody, Population.scripted("scratch-v0", [Person("tremor")], ("shy",))]).save(folder)
    splits.save(splits.path_of(folder, "random"), parts := splits.split(everybody, "random"))
    members = everybody.select(parts["train"])
    options = "--partner", f"human={folder}:random/train", "--episodes", 3
    report = json.loads(assistax_command("crossplay", run.folder, "still", *options, "--json").stdout)
    assert report["persons"] == [one[:12] for one in members.ids] and report["robots"] == ["run", "still"]
    assert report["self_play"] is None
    for i, person in enumerate(members.people):
        env = Run.open(run.folder, {"env.human.people": (person,)}).env
        team = run.teams()[0] | {"human": members.select(members.ids[i : i + 1]).partner("human")}
        alone = summarize(Evaluator(env, 3)(team))
        np.testing.assert_allclose(report["return"][0][i], alone["mean_return"], rtol=1e-4)
        np.testing.assert_allclose(report["force_in_contact"][0][i], alone["force"]["mean_in_contact"], rtol=1e-3)
    assert len({*report["return"][0]}) == len(members)
    table = assistax_command("crossplay", run.folder, "--partner", f"human={folder}", "--episodes", 1).stdout
    assert len(table.splitlines()) == 3 and len(table.splitlines()[0].split()) == 5 + 7
    for partner, said in (
        ("human=shy", "Cross-play takes --partner human=POP or human=POP:KIND/PART, not human=shy"),
        (f"robot={folder}", "Cross-play takes --partner human=POP"),
        (f"human={folder}:random", "Name a split and a part"),
    ):
        with pytest.raises(SystemExit):
            assistax_command("crossplay", run.folder, "--partner", partner)
        assert said in capsys.readouterr().err
    with pytest.raises(SystemExit):
        assistax_command("crossplay", "feeding", "--partner", f"human={folder}")
    assert "is of scratch-v0 and cannot play the human in feeding" in capsys.readouterr().err
