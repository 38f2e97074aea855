"""Who acts: the interface of a policy, players and teams, and the scripted ones."""

from assistax.policies.player import Mixed, Player, Policy, Team, check_acts, check_team, stack
from assistax.policies.scripted import SCRIPTED, Random, Still, scripted_player, scripted_policy, scripted_team

__all__ = [
    "SCRIPTED",
    "Mixed",
    "Player",
    "Policy",
    "Random",
    "Still",
    "Team",
    "check_acts",
    "check_team",
    "scripted_player",
    "scripted_policy",
    "scripted_team",
    "stack",
]
