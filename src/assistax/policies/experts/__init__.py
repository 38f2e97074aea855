"""Scripted robots, one per task.

They show that every task can be done with the robot's own torques, give learned policies something to
be measured against, and are partners for ad-hoc teamwork. They are `privileged`: instead of an
observation they are given the whole EnvState.
"""

from importlib import import_module

from assistax.errors import UsageError
from assistax.policies.player import Policy


def expert(env, considerate: bool = False) -> Policy:
    """The scripted robot of the environment's task; a considerate one keeps to what the person prefers."""
    if env.spec.expert is None:
        raise UsageError(f"There is no scripted robot for {env.name}; choose another policy.")
    module, _, name = env.spec.expert.partition(":")
    return getattr(import_module(module), name)(env, considerate)
