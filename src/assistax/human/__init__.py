"""Who the person is: what they find hard (disability) and how they like it done (preference)."""

from assistax.human.disability import DISABILITIES, Disability
from assistax.human.preference import Preference
from assistax.human.profile import HumanConfig, HumanProfile

__all__ = ["DISABILITIES", "Disability", "HumanConfig", "HumanProfile", "Preference"]
