"""Programs are the same for people and partners who differ in numbers only."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import assistax
from assistax import programs
from assistax.evaluation.playing import Evaluator
from assistax.learning.ppo.trainer import PPO, PPOConfig
from assistax.policies import Player, scripted_team

SMALL = PPOConfig(num_steps=2, num_minibatches=1, update_epochs=1, hidden=(4,))


@pytest.fixture
def kept(monkeypatch):
    """Texts of the programs made from now on."""
    texts, plainly = [], programs._program

    def noted(fn, donate, args):
        program, numbers, out = plainly(fn, donate, args)
        rest = [arg for i, arg in enumerate(args) if i != donate]
        texts.append(program.lower(None if donate is None else args[donate], rest, numbers).as_text())
        return program, numbers, out

    monkeypatch.setattr(programs, "_program", noted)
    return texts


def test_it_gives_what_the_function_gives(kept):
    table = jnp.arange(6.0).reshape(2, 3)

    def fn(tree, row):
        return {"sum": tree["a"] + table[row], "none": None, "twice": (table * 2,)}

    made = programs.jit(fn)
    for row in (0, 1):
        got, want = made({"a": jnp.ones(3)}, jnp.int32(row)), fn({"a": jnp.ones(3)}, row)
        jax.tree.map(np.testing.assert_array_equal, got, want)
    assert len(kept) == 1
    made({"a": jnp.ones(1)}, jnp.int32(0))  # another shape is another program
    assert len(kept) == 2


@pytest.mark.parametrize("place", [0, 1])
def test_what_is_donated_is_used_up_and_nothing_else(place):
    args = [jnp.ones(1000), jnp.full(1000, 2.0)]
    more = jnp.full(1000, 3.0)
    out = programs.jit(lambda a, b: a * b + more, donate=place)(*args)
    np.testing.assert_array_equal(out, np.full(1000, 5.0))
    assert [arg.is_deleted() for arg in args] == [place == i for i in (0, 1)]
    assert not more.is_deleted()


def programs_of(human, kept):
    """Texts of a training's and an evaluation's programs beside this person, and what the evaluation returns."""
    kept.clear()
    env = assistax.make("scratch", episode_length=4, human=human)
    trainer = PPO(env, SMALL, 2, 1)
    state = programs.jit(trainer.init)(jax.random.key(0))
    state, batch = programs.jit(trainer.collect, donate=0)(state)
    programs.jit(trainer.improve, donate=0)(state, batch)
    played = Evaluator(env, 2)(scripted_team("random", env))
    return list(kept), played["metrics"]["return"]


def test_people_who_differ_in_numbers_share_all_programs(kept):
    preferring = "speed=0.03:0.07 force=0.5:1 weights=0.3,0.35,-0.03"
    weak, one = programs_of({"disability": "weakness", "preference": "default"}, kept)
    shaking, other = programs_of({"disability": "tremor", "preference": preferring}, kept)
    assert len(weak) == 4
    assert weak == shaking
    assert not np.array_equal(one, other)  # nonetheless they are two people
    healthy, _ = programs_of({"preference": "default"}, kept)
    assert healthy != weak  # without weakness and tremor a step does less


def test_frozen_partners_who_differ_in_weights_share_all_programs(kept):
    env = assistax.make("scratch", episode_length=4)
    alone = PPO(env, SMALL, 2, 1)
    for seed in (1, 2):
        state = alone.init(jax.random.key(seed))
        partner = Player.of(alone.policy(), alone.policy_params(state)["human"])
        trainer = PPO(env, SMALL, 2, 1, {"human": partner})
        programs.jit(trainer.collect)(trainer.init(jax.random.key(0)))
    assert len(kept) == 2
    assert kept[0] == kept[1]
