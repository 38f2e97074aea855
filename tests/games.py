"""Tiny games with the interface of `assistax.env.Env` whose best play is known."""

from functools import partial

import jax
import jax.numpy as jnp


class Game:
    """Auto-reset, time limit and episode return; a game says what `begin`, `play`, `see` and `global_obs` are."""

    agents: tuple[str, ...] = ("robot", "human")
    episode_length = 5
    ending = 0.0  # probability that a step ends the episode for good

    def extra(self, actions):
        """What else a step's info has."""
        return {}

    def reset(self, key, elapsed=0):
        state = self.begin(key) | {"t": jnp.int32(0) + elapsed, "return": jnp.float32(0.0)}
        return self.see(state), state

    def step(self, key, state, actions):
        end_key, play_key, reset_key = jax.random.split(key, 3)
        reward, moved = self.play(play_key, state, actions)
        end = state | moved | {"t": state["t"] + 1, "return": state["return"] + reward}
        terminated = jax.random.uniform(end_key) < self.ending
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
