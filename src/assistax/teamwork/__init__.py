"""Who can work with whom: teams of policies that were not trained together."""
