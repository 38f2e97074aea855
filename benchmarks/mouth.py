"""Where spoon and bristles are, as seen from the mouth, while the episode counts that they help.

uv run python benchmarks/mouth.py --out results/mouth.json
uv run python benchmarks/mouth.py --tasks feeding-v2 --policies RUN   # a run folder with a checkpoint

Means over the counted steps of all episodes, in cm: ahead of the mouth's middle, to its left, and up. Of the spoon it
is the point of the bowl, between its middle and its tip, that is nearest to the mouth.
"""

import argparse
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

from assistax.cli.common import teams_of
from assistax.evaluation import turns
from assistax.files import write_json
from assistax.scenes import geometry
from assistax.stamp import stamp

COUNTED = {f"feeding-v{version}": "mouth_seconds" for version in (1, 2, 3)}
COUNTED |= {f"tooth_brushing-v{version}": "brush_seconds" for version in (1, 2)}


def nearest(env, s):
    """The tool's point [3] m that is to be at the mouth, in the mouth's frame."""
    to_mouth, tip = s["mouth_pos"] - s["tool_pos"], geometry.matrix(s["tool_quat"])[:, 2]
    along = jnp.clip(to_mouth @ tip, 0.0, getattr(env.task.config, "bowl", 0.0))
    return geometry.matrix(s["mouth_quat"]).T @ (along * tip - to_mouth)


def measure(task: str, policy: str, episodes: int) -> dict:
    """Of one team: a policy of `assistax evaluate --policy`, or a run folder."""
    named = (policy, None) if Path(policy).is_dir() else (task, policy)
    env, (team, *_), _ = teams_of(*named, engine=None, assignments=())
    name = COUNTED[task]

    def play(key):
        params, turn = turns.begin(env, team, key)

        def step(turn, key):
            before = getattr(turn.state.task, name)
            turn, _, over = turns.advance(env, team, params, turn, key)
            counts = (getattr(turn.state.task, name) > before) & ~over
            return turn, (nearest(env, env.sensors(turn.state.physics)), counts)

        return jax.lax.scan(step, turn, jax.random.split(key, env.config.episode_length))[1]

    places, counts = jax.jit(jax.vmap(play))(jax.random.split(jax.random.key(0), episodes))
    places = 100.0 * np.asarray(places, float)[np.asarray(counts)]
    return {
        "seconds": round(float(counts.sum() * env.dt / episodes), 2),
        "ahead_left_up": np.round(places.mean(0), 2).tolist(),
        "spread": np.round(places.std(0), 2).tolist(),
        "distance": round(float(np.linalg.norm(places, axis=1).mean()), 2),
    }


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--tasks", nargs="+", default=[*COUNTED], choices=COUNTED)
    parser.add_argument("--policies", nargs="+", default=["trained", "offer"])
    parser.add_argument("--episodes", type=int, default=16)
    parser.add_argument("--out", type=Path)
    chosen = parser.parse_args()
    found: dict[str, dict] = {}
    for task in chosen.tasks:
        for policy in chosen.policies:
            found.setdefault(task, {})[policy] = measure(task, policy, chosen.episodes)
            print(task, policy, found[task][policy], flush=True)
    if chosen.out:
        write_json(chosen.out, {"tasks": found, "episodes": chosen.episodes} | stamp())


if __name__ == "__main__":
    main()
