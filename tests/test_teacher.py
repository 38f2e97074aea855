"""Scripted teachers of learners: their parts by hand, a game in which reward is told nothing of what is shown."""

from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from games import Meeting

import assistax
from assistax.errors import UsageError
from assistax.human import Person
from assistax.learning.ppo import PPO, PPOConfig
from assistax.learning.teacher import Teacher, imitation_loss, teaching_weight
from assistax.policies import Player, Still
from assistax.teamwork.plan import Plan
from assistax.training.checkpoint import load_checkpoint, save_checkpoint
from assistax.training.configuration import configure

QUICK = PPOConfig(learning_rate=3e-3, entropy_coef=0.0, hidden=(16,), num_steps=10, update_epochs=4, num_minibatches=2)
QUICK = replace(QUICK, initial_log_std=-2.0, gamma=0.9)


@dataclass(frozen=True)
class Contrary:
    """Knows c, which the human should answer with -0.25 c, and shows 0.5 c; adds 0.01 for each step of the episode."""

    privileged = True

    def initial_carry(self):
        return jnp.int32(0)

    def act(self, params, carry, state, reset, key):
        carry = jnp.where(reset, 0, carry) + 1
        return 0.5 * state["c"][None] + 0.01 * (carry - 1), carry


def taught(num_envs, iterations, **settings):
    ppo = PPO(Meeting(), replace(QUICK, **settings), num_envs, iterations)
    ppo.teacher.players["human"] = Player(Contrary())
    return ppo


def learned(ppo, iterations):
    step = jax.jit(lambda state: ppo.improve(*ppo.collect(state)))
    state = jax.jit(ppo.init)(jax.random.key(0))
    for _ in range(iterations):
        state, stats = step(state)
    return state, stats


def answer(ppo, state, c):
    actor, params = ppo.policy(), ppo.policy_params(state)["human"]
    return float(actor.act(params, actor.initial_carry(), jnp.array([c]), jnp.bool_(True), jax.random.key(0))[0][0])


def test_the_loss_and_its_weight_by_hand():
    mean, shown = jnp.array([[0.5, 0.0], [1.0, -1.0]]), jnp.array([[0.0, 0.0], [1.0, 1.0]])
    log_std = jnp.log(jnp.array([0.5, 2.0]))
    # 1 and 0 standard deviations in the first sample, 0 and 1 in the second: half of 1, twice.
    np.testing.assert_allclose(imitation_loss(mean, shown, log_std), 0.5, rtol=1e-6)
    assert np.all(jax.grad(imitation_loss, 2)(mean, shown, log_std) == 0), "noise must not grow to explain"
    for floor in (0.0, 0.1):
        weights = [float(teaching_weight(200, floor, steps)) for steps in (0, 50, 200, 900)]
        np.testing.assert_allclose(weights, [1.0, 0.75, floor, floor])
    ppo = taught(4, 3, teaching_steps=40)
    assert ppo._teaching(ppo.config, jnp.int32(2**31 - 1)) == 0.0  # however long a run, it does not begin anew


def test_what_is_shown_belongs_to_the_state_of_the_learner():
    ppo = taught(4, 1)
    _, batch = jax.jit(ppo.collect)(ppo.init(jax.random.key(0)))
    seen = batch["obs"]["robot"]  # c, and a tenth of the step in the episode
    assert set(batch["shown"]) == {"human"}
    steps_begun = np.cumsum(np.asarray(batch["reset"]), 0) > 1  # episodes that began staggered count from there
    expected = 0.5 * seen[..., :1] + 0.1 * seen[..., 1:]
    np.testing.assert_allclose(batch["shown"]["human"][steps_begun], expected[steps_begun], atol=1e-6)
    assert steps_begun.sum() > 8


def test_imitation_comes_first_and_reward_has_the_last_word():
    imitating = taught(64, 40, teaching_steps=10**9)
    state, stats = learned(imitating, 40)
    assert abs(answer(imitating, state, 1.0) - 0.52) < 0.06, "what was shown, against the reward"
    assert float(stats["human"]["imitation_loss"]) > 0 and "imitation_loss" not in stats["robot"]
    nothing = taught(64, 5, teaching_steps=10**9, teaching_coef=0.0)
    assert abs(answer(nothing, learned(nothing, 5)[0], 1.0)) < 0.05, "neither reward nor what was shown"
    over = taught(64, 80, teaching_steps=10 * 64 * 20)
    state, _ = learned(over, 80)
    assert abs(answer(over, state, 1.0) + 0.25) < 0.06, "what pays, once teaching is over"


WANTED = {  # docs/training.md and docs/defaults.md: limit, floor, steps of teaching, noise at first and in the end
    "scratch": (2.0, 0.004, 1e6, 0.14, 0.02),
    "bed_bath": (3.0, 0.02, 2e6, 0.08, 0.05),
    "arm_assist": (5.0, 0.0, 1e6, 0.22, 0.05),
    "feeding": (0.5, 0.0, 1e6, 0.22, 0.05),
    "tooth_brushing": (2.0, 0.0, 1e6, 0.22, 0.05),
}


@pytest.mark.parametrize("task", WANTED)
def test_the_default_is_what_the_pages_say(task):
    found = configure(task, {}).method
    noise = [round(float(np.exp(x)), 2) for x in (found.initial_log_std, found.final_log_std)]
    assert (found.cost_limit, found.teaching_floor, found.teaching_steps, *noise) == WANTED[task]


@pytest.mark.parametrize("floor", [0.0, 0.01])
def test_teaching_stops_for_good_unless_it_has_a_floor(floor):
    ppo = taught(4, 3, teaching_steps=40, teaching_floor=floor)  # one iteration
    state, first = jax.jit(ppo.collect)(ppo.init(jax.random.key(0)))
    state, _ = jax.jit(ppo.improve)(state, first)
    _, later = jax.jit(ppo.collect)(state)
    assert np.any(first["shown"]["human"]) and np.any(later["shown"]["human"]) == (floor > 0)


@pytest.mark.parametrize(("teaching_kl", "slowed"), [(0.0, False), (1e-3, True), (1e3, False)])
def test_who_is_taught_may_move_as_far_as_it_has_to_unless_there_is_a_limit(teaching_kl, slowed):
    ppo = taught(64, 4, teaching_steps=10**9, teaching_kl=teaching_kl, desired_kl=1e-3)
    _, stats = learned(ppo, 2)
    assert stats["human"]["approx_kl"] > 2 * 2e-3 and (stats["human"]["rate_scale"] < 1.0) == slowed


def test_the_limit_on_who_is_taught_comes_down_to_the_usual_one_with_what_is_taught():
    steps = 10 * 64 * 4  # of four iterations
    for teaching_kl in (0.0, 1e3):  # with either the first three may move freely
        ppo = taught(64, 8, teaching_steps=steps, teaching_kl=teaching_kl, desired_kl=1e-5)
        assert learned(ppo, 3)[1]["human"]["rate_scale"] == 1.0
        assert learned(ppo, 6)[1]["human"]["rate_scale"] < 1.0


def test_resume_equals_uninterrupted_to_the_bit(tmp_path):
    ppo = taught(4, 4)
    step = jax.jit(lambda state: ppo.improve(*ppo.collect(state))[0])
    state = jax.jit(ppo.init)(jax.random.key(0))
    for i in range(4):
        if i == 2:
            save_checkpoint(tmp_path / "c", state, {})
        state = step(state)
    resumed = step(step(load_checkpoint(tmp_path / "c", jax.eval_shape(ppo.init, jax.random.key(0)))))
    assert (state.teacher["human"] > 0).any()
    jax.tree.map(
        np.testing.assert_array_equal,
        replace(state, key=jax.random.key_data(state.key)),
        replace(resumed, key=jax.random.key_data(resumed.key)),
    )


def test_the_offering_person_teaches_what_it_does():
    """In a real task: shown is what the scripted person itself would do."""
    env = assistax.make("feeding", engine="mujoco")
    teacher = Teacher(env, 2, ["human=offer"], ("robot", "human"))
    obs, state = jax.vmap(env.reset)(jax.random.split(jax.random.key(0), 2))
    reset, key = jnp.ones(2, bool), jax.random.key(1)
    shown, _ = jax.jit(teacher.show)(teacher.init(), state, obs, reset, key)
    policy = teacher.players["human"].policy
    for i in range(2):
        one = jax.tree.map(lambda x, i=i: x[i], state)
        alone, _ = policy.act((), policy.initial_carry(), one, jnp.bool_(True), key)
        np.testing.assert_allclose(shown["human"][i], jnp.clip(alone, -1, 1), atol=1e-5)
    assert np.abs(shown["human"]).max() > 0.01


def test_the_default_preset_of_version_1_has_teachers():
    both = ("robot=expert", "human=offer")
    assert (
        configure("feeding", {}).method.teachers == configure("feeding", {}, algorithm="mappo").method.teachers == both
    )
    assert configure("scratch", {}).method.teachers == configure("bed_bath", {}).method.teachers == both
    assert configure("feeding-v0", {}).method.teachers == configure("feeding", {}, preset="paper").method.teachers == ()
    # The scripted robot plays with torques.
    assert configure("feeding", {"env.control": "position"}).method.teachers == both[1:]
    assert configure("feeding", {"ppo.teachers": ()}).method.teachers == ()
    # Who likes something is helped as they like it by the considerate robot, unless another was asked for.
    liking = {"env.human.preference": "default"}
    assert configure("feeding", liking).method.teachers == ("robot=considerate", "human=offer")
    assert configure("feeding", liking | {"ppo.teachers": both}).method.teachers == both
    assert configure("feeding", liking, algorithm="masac").algorithm == "masac"
    # People of a population would all be alike if one script had taught them.
    plan = Plan("feeding", (Person(),), ("ippo", "masac"))
    (_, alone), (_, _) = plan.jobs()
    assert alone.method.teachers == () and alone.method.initial_log_std == -1.0


def test_teachers_that_cannot_teach_are_refused():
    env = assistax.make("feeding", engine="mujoco")
    beside_a_frozen_person = PPO(env, replace(QUICK, teachers=("human=offer",)), 4, 1, {"human": Player(Still(2))})
    assert not beside_a_frozen_person.teacher.players
    for name, message in (
        ("human=expert", "human's policy"),
        ("dog=offer", "agent of ppo.teachers"),
        ("human", "human's policy"),
    ):
        with pytest.raises(UsageError, match=message):
            PPO(env, replace(QUICK, teachers=(name,)), 4, 1)
    with pytest.raises(UsageError, match="teaching_coef must be 0 or more"):
        PPOConfig(teaching_coef=-1.0)
    for floor in (-0.1, 1.1, np.nan):
        with pytest.raises(UsageError, match="teaching_floor must be from 0 to 1"):
            PPOConfig(teaching_floor=floor)
    with pytest.raises(UsageError, match="teaching_kl must be 0 or more"):
        PPOConfig(teaching_kl=-1.0)
    with pytest.raises(UsageError, match="teaching_steps"):
        PPOConfig(teaching_steps=0)


def test_a_person_may_be_taught_a_habit():
    env = assistax.make("scratch")
    shown = {}
    for name in ("offer", "offers", "offers_second_way"):
        teacher = Teacher(env, 64, (f"human={name}",), ("robot", "human"))
        obs, state = jax.vmap(env.reset)(jax.random.split(jax.random.key(0), 64))
        start = jnp.ones(64, bool)
        shown[name], _ = teacher.show(teacher.init(), state, obs, start, jax.random.key(1))
    np.testing.assert_allclose(shown["offers"]["human"], shown["offer"]["human"], atol=1e-6)
    assert np.abs(shown["offers_second_way"]["human"] - shown["offer"]["human"]).max() > 0.05
