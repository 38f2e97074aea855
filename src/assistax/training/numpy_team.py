"""Trained teams in NumPy, from wherever they are stored: see inference.py."""

from pathlib import Path
from zipfile import BadZipFile

from assistax.errors import UsageError
from assistax.inference import NumPyTeam
from assistax.policies import Team
from assistax.training import team_file
from assistax.training.run import Run


def load_team(target: str | Path) -> NumPyTeam:
    """The trained team of a task ("scratch", of the newest version that has one), a team file, a run folder (its first
    seed), or an .npz that `NumPyTeam.save` wrote.

    Raises:
      UsageError: there is no such team, or one of its agents is not played by a network.
    """
    path = Path(target)
    if path.suffix == ".npz":
        try:
            return NumPyTeam.load(path)
        except (OSError, KeyError, ValueError, BadZipFile) as error:
            raise UsageError(f"Cannot read a team from {path}: {str(error) or type(error).__name__}.") from None
    if path.is_dir():
        team = Run.open(path).teams(deterministic=True)[0]
    else:
        _, team = team_file.load_team(path if path.suffix == ".safetensors" else team_file.trained_file(str(target)))
    return as_numpy(team)


def as_numpy(team: Team) -> NumPyTeam:
    """The first members of the players of a trained team."""
    policies = {}
    for agent, player in team.items():
        convert = getattr(player.policy, "as_numpy", None)
        if convert is None:
            raise UsageError(
                f"Only networks can be had in NumPy, not the {type(player.policy).__name__} that plays the {agent}."
            )
        policies[agent] = convert(player.member(0))
    return NumPyTeam(policies)
