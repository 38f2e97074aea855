"""Who acts: the interface of a policy, teams of them, and the scripted ones."""

from assistax.policies.policy import Drawn, Policy, Team
from assistax.policies.scripted import SCRIPTED, Random, Still, scripted_policy, scripted_team

__all__ = ["SCRIPTED", "Drawn", "Policy", "Random", "Still", "Team", "scripted_policy", "scripted_team"]
