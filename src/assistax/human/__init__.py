"""Who the person is: what they find hard (disability) and how they like it done (preference)."""

from assistax.human.config import HumanConfig
from assistax.human.disability import DISABILITIES, Disability
from assistax.human.population import profiles
from assistax.human.preference import Preference
from assistax.human.profile import HumanProfile, Person

__all__ = ["DISABILITIES", "Disability", "HumanConfig", "HumanProfile", "Person", "Preference", "profiles"]
