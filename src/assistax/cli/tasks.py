"""`assistax tasks`."""

from assistax.cli.common import Json, print_json


def tasks(*, json: Json = False) -> None:
    """List the tasks.

    Args:
      json: print JSON, with the sizes of observations and actions.
    """
    from assistax.env import make
    from assistax.tasks import TASKS

    if not json:
        for name, task in TASKS.items():
            print(f"{name:18} {task.title}")
        return
    listing = {}
    for name, task in TASKS.items():
        env = make(name, engine="mujoco")
        listing[name] = {
            "title": task.title,
            "observations": env.observation_sizes | {"global": env.global_size},
            "actions": env.action_sizes,
            "episode_length": env.config.episode_length,
            "control_period_s": env.dt,
        }
    print_json(listing)
