"""Tiny games with the interface of `assistax.env.Env` whose best play is known."""

from functools import partial

import jax
import jax.numpy as jnp

from assistax.learning.ppo import PPO, PPOConfig


class Game:
    """Auto-reset, time limit and episode return; a game says what `begin`, `play`, `see` and `global_obs` are."""

    agents: tuple[str, ...] = ("robot", "human")
    episode_length = 5
    ending = 0.0  # probability that a step ends the episode for good

    def extra(self, actions):
        """What else a step's info has."""
        return {}

    def over(self, state):
        """Whether this state ends the episode for good, beside chance."""
        return jnp.bool_(False)

    def reset(self, key, elapsed=0):
        state = self.begin(key) | {"t": jnp.int32(0) + elapsed, "return": jnp.float32(0.0)}
        return self.see(state), state

    def step(self, key, state, actions):
        end_key, play_key, reset_key = jax.random.split(key, 3)
        reward, moved = self.play(play_key, state, actions)
        end = state | moved | {"t": state["t"] + 1, "return": state["return"] + reward}
        terminated = (jax.random.uniform(end_key) < self.ending) | self.over(end)
        truncated = (end["t"] >= self.episode_length) & ~terminated
        _, fresh = self.reset(reset_key)
        info = self.extra(actions) | {
            "final_observation": self.see(end),
            "final_global_observation": self.global_obs(end),
            "metrics": {"return": end["return"]},
            "reward_terms": {"all": reward},
            "fault": jnp.int32(0),
        }
        state = jax.tree.map(partial(jnp.where, terminated | truncated), fresh, end)
        rewards = dict.fromkeys(self.agents, reward)
        return self.see(state), state, rewards, {"__all__": terminated}, {"__all__": truncated}, info


class Meeting(Game):
    """Both are shown a context c in {-1, 1}; the robot should play 0.5 c twice, the human -0.25 c.

    Reward 1 - the squared errors, so the optimum is 1 a step.
    """

    observation_sizes, action_sizes, global_size = {"robot": 2, "human": 1}, {"robot": 2, "human": 1}, 2

    def __init__(self, ending=0.0):
        self.ending = ending

    def begin(self, key):
        return {"c": jnp.where(jax.random.bernoulli(key), 1.0, -1.0)}

    def see(self, state):
        return {"robot": self.global_obs(state), "human": state["c"][None]}

    def global_obs(self, state):
        return jnp.stack([state["c"], 0.1 * state["t"]])

    def play(self, key, state, actions):
        error = jnp.sum((actions["robot"] - 0.5 * state["c"]) ** 2)
        error += jnp.sum((actions["human"] + 0.25 * state["c"]) ** 2)
        return 1.0 - error, {}


class Weather(Game):
    """The human should play 0.5 and the robot -0.5, but luck of ±10, which only the global state shows, is added.

    Why a central critic helps: the advantage of an own-observation critic carries the luck's variance,
    100, in every sample, whereas what a policy with standard deviation 1 can gain varies by about 3. A
    critic that sees the luck subtracts it, and nothing but the gain is left to learn from.
    """

    observation_sizes, action_sizes, global_size = {"robot": 1, "human": 1}, {"robot": 1, "human": 1}, 2
    ending = 1.0

    def begin(self, key):
        return {"luck": jnp.where(jax.random.bernoulli(key), 10.0, -10.0)}

    def see(self, state):
        return {agent: jnp.ones(1) for agent in self.agents}

    def global_obs(self, state):
        return jnp.stack([state["luck"], 1.0])

    def play(self, key, state, actions):
        error = jnp.square(actions["human"][0] - 0.5) + jnp.square(actions["robot"][0] + 0.5)
        return state["luck"] - error, {}


class Moods(Game):
    """The robot should play -0.5, but ten times what the human plays is added, which the robot does not see.

    Why a critic that knows who plays helps: as in Weather, with people of two moods in place of luck.
    """

    observation_sizes, action_sizes, global_size = {"robot": 1, "human": 1}, {"robot": 1, "human": 1}, 1
    ending = 1.0

    def begin(self, key):
        return {}

    def see(self, state):
        return {agent: jnp.ones(1) for agent in self.agents}

    def global_obs(self, state):
        return jnp.ones(1)

    def play(self, key, state, actions):
        return 10.0 * actions["human"][0] - jnp.square(actions["robot"][0] + 0.5), {}


class Cue(Game):
    """A cue c in {-1, 0, 1} is shown at the first step of an episode only, and should be played ever after.

    Reward 1 - (action - c)²: 1 a step for who remembers. Without memory the best after the first step
    is to play 0, worth 1 - 2/3. Episodes end at random, and a zero cue looks like the going on of the
    episode before: who does not forget there plays the old cue.
    """

    agents, episode_length, ending = ("robot",), 8, 0.2
    observation_sizes, action_sizes, global_size = {"robot": 1}, {"robot": 1}, 1

    def begin(self, key):
        return {"c": jnp.float32(jax.random.randint(key, (), -1, 2))}

    def see(self, state):
        return {"robot": self.global_obs(state)}

    def global_obs(self, state):
        return jnp.where(state["t"] == 0, state["c"], 0.0)[None]

    def play(self, key, state, actions):
        return 1.0 - jnp.square(actions["robot"][0] - state["c"]), {}


class Recall(Game):
    """A cue c in {-1, 1} is shown at the first step; after 6 to 10 steps of other such signs it is asked for, once.

    Reward 1 - (action - c)² where it is asked, worth 1, else 0; then the episode is over. Without memory the best is to
    play 0, worth 0. Nothing but the cue of this very episode helps: signs look like cues, the delay is random, and what
    an episode before has left is misleading.
    """

    agents, episode_length = ("robot",), 11
    observation_sizes, action_sizes, global_size = {"robot": 3}, {"robot": 1}, 3

    def begin(self, key):
        cue_key, delay_key, signs_key = jax.random.split(key, 3)
        signs = jnp.where(jax.random.bernoulli(signs_key, shape=(11,)), 1.0, -1.0)
        cue = jnp.where(jax.random.bernoulli(cue_key), 1.0, -1.0)
        return {"c": cue, "delay": jax.random.randint(delay_key, (), 6, 11), "signs": signs.at[0].set(cue)}

    def see(self, state):
        return {"robot": self.global_obs(state)}

    def global_obs(self, state):
        first, asked = state["t"] == 0, state["t"] == state["delay"]
        return jnp.stack([state["signs"][state["t"]], first, asked])

    def play(self, key, state, actions):
        asked = state["t"] == state["delay"]
        return jnp.where(asked, 1.0 - jnp.square(actions["robot"][0] - state["c"]), 0.0), {}

    def over(self, state):
        return state["t"] > state["delay"]


class Levers(Game):
    """At the first step each pulls a lever that it cannot see, and at the fourth 1 - the squared errors is paid.

    The robot's should be at 0.5, the human's at -0.5. Only the global state shows the levers, and what follows is no
    matter of the actions. So an agent's own observations after the first step are the same whatever it did: with
    advantages of one step (gae_lambda = 0) those of an own-observation critic know nothing of the action, and there is
    nothing to learn from, however long. To a central critic the levers are worth what will be paid.
    """

    episode_length = 4
    observation_sizes, action_sizes, global_size = {"robot": 4, "human": 4}, {"robot": 1, "human": 1}, 6

    def begin(self, key):
        return {"levers": jnp.zeros(2)}

    def see(self, state):
        return dict.fromkeys(self.agents, jax.nn.one_hot(state["t"], 4))

    def global_obs(self, state):
        return jnp.concatenate([jax.nn.one_hot(state["t"], 4), state["levers"]])

    def play(self, key, state, actions):
        pulled = jnp.stack([actions["robot"][0], actions["human"][0]])
        levers = jnp.where(state["t"] == 0, pulled, state["levers"])
        reward = 1.0 - jnp.sum(jnp.square(levers - jnp.array([0.5, -0.5])))
        return jnp.where(state["t"] == 3, reward, 0.0), {"levers": levers}

    def over(self, state):
        return state["t"] > 3


class Integrator(Game):
    """A point x, to be brought to 0: x moves by 0.3 u, each step costs x² + 0.1 u², x begins in [-2, 2].

    The best play of an endless episode is u = -2 x, worth -5/3 x²: the positive root of p² - p = 10/9 (Riccati). It
    is so with independent noise in u too. Correlated noise pushes x along, and is best met with a higher gain.
    """

    agents, episode_length = ("robot",), 50
    observation_sizes, action_sizes, global_size = {"robot": 1}, {"robot": 1}, 1
    optimum = -20.0 / 9.0  # -5/3 E[x²]

    def begin(self, key):
        return {"x": jax.random.uniform(key, (), minval=-2.0, maxval=2.0)}

    def see(self, state):
        return {"robot": self.global_obs(state)}

    def global_obs(self, state):
        return state["x"][None]

    def play(self, key, state, actions):
        u = actions["robot"][0]
        return -jnp.square(state["x"]) - 0.1 * jnp.square(u), {"x": state["x"] + 0.3 * u}


class Fines(Game):
    """Both should play 1, but a step costs max(0, robot's action) + 2 max(0, human's); reward 2 - the squared errors.

    With at most c a step, where c is below 3, the best is to give way in proportion to the fine: the robot plays
    1 - (3 - c) / 5 and the human 1 - 2 (3 - c) / 5, worth 2 - (3 - c)² / 5.
    """

    observation_sizes, action_sizes, global_size = {"robot": 1, "human": 1}, {"robot": 1, "human": 1}, 1

    def __init__(self, episode_length=5, unit=1.0):
        self.episode_length, self.unit = episode_length, unit

    def begin(self, key):
        return {}

    def see(self, state):
        return {agent: self.global_obs(state) for agent in self.agents}

    def global_obs(self, state):
        return jnp.ones(1)

    def play(self, key, state, actions):
        return 2.0 - sum(jnp.sum(jnp.square(action - 1.0)) for action in actions.values()), {}

    def extra(self, actions):
        robot, human = (jnp.maximum(actions[agent][0], 0.0) for agent in self.agents)
        return {"cost": self.unit * (robot + 2.0 * human)}


class Stranger(Game):
    """The robot sees the human's last action until the third step, and should do as this human does from then on.

    Reward 1 - (the robot's action - the human's)² from the third step on, else 0. Where humans play 1 or -1 all the
    time, who knows with whom it plays earns 1 a step, who does not plays 0 and earns 0. It may be `shown` more steps.
    """

    episode_length = 10

    def __init__(self, shown=3):
        self.shown = shown

    observation_sizes, action_sizes, global_size = {"robot": 2, "human": 1}, {"robot": 1, "human": 1}, 2

    def begin(self, key):
        return {"done": jnp.float32(0.0)}

    def see(self, state):
        early = state["t"] < self.shown
        return {"robot": jnp.stack([early * state["done"], 1.0 * early]), "human": state["done"][None]}

    def global_obs(self, state):
        return self.see(state)["robot"]

    def play(self, key, state, actions):
        paid = 1.0 - jnp.square(actions["robot"][0] - actions["human"][0])
        return jnp.where(state["t"] >= 3, paid, 0.0), {"done": actions["human"][0]}


def trained(game, iterations, num_envs=64, partners=None, **settings):
    """(trainer, state, stats, the last batch) after some iterations of PPO."""
    ppo = PPO(game, PPOConfig(**settings), num_envs, iterations, partners)
    collect, improve = jax.jit(ppo.collect), jax.jit(ppo.improve)
    state, stats, batch = jax.jit(ppo.init)(jax.random.key(0)), {}, {}
    for _ in range(iterations):
        state, batch = collect(state)
        state, stats = improve(state, batch)
    return ppo, state, stats, batch
